"""Evaluation of a policy on fixed scenes: episodes, metrics, trajectories, video."""

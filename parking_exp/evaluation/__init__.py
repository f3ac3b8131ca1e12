"""Evaluation of a policy from fixed seeds: episodes, metrics, video."""

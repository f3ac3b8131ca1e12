"""Hydra-configured experiment sweeps for goal-conditioned parking."""

__version__ = "0.1.0"

"""Parking environments: highway-env's parking-v0 and the variants that the `env` group configures."""

from parking_exp.envs.highway import SparseReward, make_env

__all__ = ["SparseReward", "make_env"]

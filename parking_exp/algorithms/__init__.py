"""Algorithms: Stable-Baselines3's SAC, TD3 and DDPG with a faster update, CrossQ, and models from configs."""

from parking_exp.algorithms.fast import DDPG, SAC, TD3

__all__ = ["DDPG", "SAC", "TD3"]

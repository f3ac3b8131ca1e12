"""SAC, TD3 and DDPG of Stable-Baselines3 with a faster update: the same arithmetic in less time."""

from parking_exp.algorithms.fast.sac import SAC
from parking_exp.algorithms.fast.td3 import DDPG, TD3

__all__ = ["DDPG", "SAC", "TD3"]

"""SAC, TD3 and DDPG with a faster update, CrossQ, and models built from configs."""

from parking_exp.algorithms.fast.sac import SAC
from parking_exp.algorithms.fast.td3 import DDPG, TD3

__all__ = ["DDPG", "SAC", "TD3"]

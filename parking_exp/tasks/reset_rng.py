"""The generator that a Gymnasium env samples an episode with."""

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding


def reset_rng(env: gym.Env, seed: int | None) -> np.random.Generator:
    """Return the generator that the next `env.reset(seed=seed)` samples from."""
    if seed is None:
        return env.unwrapped.np_random
    return seeding.np_random(seed)[0]

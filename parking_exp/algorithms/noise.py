"""Exploration noise of many envs, drawn at once."""

import numpy as np
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise


class VectorizedNormalNoise(VectorizedActionNoise):
    """Stable-Baselines3's `VectorizedActionNoise` of normal noise: the same numbers in one call instead of `n_envs`."""

    base_noise: NormalActionNoise

    def __call__(self) -> np.ndarray:
        """Return noise of shape (n_envs, actions)."""
        base = self.base_noise
        return np.random.normal(base._mu, base._sigma, (self.n_envs, len(base._mu))).astype(base._dtype)

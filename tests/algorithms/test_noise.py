"""Exploration noise."""

import numpy as np
import pytest
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise

from parking_exp.algorithms.noise import VectorizedNormalNoise


@pytest.mark.parametrize("actions", [1, 2, 3])
def test_noise_of_many_envs_is_what_stable_baselines3_draws_one_by_one(actions):
    base = NormalActionNoise(np.arange(actions) / 10, np.arange(1, actions + 1) / 10)
    found = []
    for vectorized in (VectorizedNormalNoise, VectorizedActionNoise):
        np.random.seed(7)
        noise = vectorized(base, 5)
        found.append(np.stack([noise() for _ in range(4)]))
    ours, theirs = found
    assert ours.shape == (4, 5, actions)
    assert ours.dtype == theirs.dtype
    np.testing.assert_array_equal(ours, theirs)

"""Exploration noise: our own against Stable-Baselines3's, and what the random actions are."""

import numpy as np
import pytest
from stable_baselines3.common.noise import NormalActionNoise, VectorizedActionNoise
from support.models import make_model

from parking_exp.algorithms.action_noise import EpsilonRandomActionNoise, VectorizedNormalNoise


@pytest.mark.parametrize("actions", [1, 3])
def test_noise_of_many_envs_is_what_stable_baselines3_draws_one_by_one(actions):
    base, draws = NormalActionNoise(np.arange(actions) / 10, np.arange(1, actions + 1) / 10), []
    for vectorized in (VectorizedNormalNoise, VectorizedActionNoise):
        np.random.seed(7)
        noise = vectorized(base, 5)
        draws.append(np.stack([noise() for _ in range(4)]))
    ours, theirs = draws
    assert (ours.shape, ours.dtype) == ((4, 5, actions), theirs.dtype)
    np.testing.assert_array_equal(ours, theirs)


def test_a_share_of_the_actions_is_random_and_the_others_have_normal_noise():
    np.random.seed(0)
    noise = EpsilonRandomActionNoise(np.zeros(2), np.full(2, 0.01), epsilon=0.3)
    drawn = np.stack([noise() for _ in range(20_000)])
    is_random = np.abs(drawn).max(1) > 0.1
    assert is_random.mean() == pytest.approx(0.3 * (1 - 0.05**2), abs=0.01)
    assert drawn[~is_random].std() == pytest.approx(0.01, rel=0.02)
    # Added to the action 0 and clipped, half of it is uniform and a quarter is at each bound.
    clipped = np.clip(drawn[is_random], -1, 1)
    for bound in (-1, 1):
        assert (clipped == bound).mean() == pytest.approx(0.25, abs=0.01)
    assert drawn.min() == pytest.approx(-2, abs=0.01) and drawn.max() == pytest.approx(2, abs=0.01)


def test_a_config_makes_it():
    target = f"{EpsilonRandomActionNoise.__module__}.{EpsilonRandomActionNoise.__name__}"
    options = [f"algorithm.action_noise._target_={target}", "++algorithm.action_noise.epsilon=1"]
    noise = make_model("experiment=smoke", "algorithm=td3", *options).action_noise
    assert (type(noise), noise.epsilon, noise().shape) == (EpsilonRandomActionNoise, 1, (2,))

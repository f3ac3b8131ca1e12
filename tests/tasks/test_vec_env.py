"""The simulator as a VecEnv: what Stable-Baselines3 gets from it is what it gets from
highway-env.
"""

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv
from support.vec_env_equality import step_alike

from parking_exp.config.compose import compose
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.parking.vec_env import ParkingVecEnv


@pytest.fixture
def config():
    return compose("env.training_duration=2").env


def test_spaces_are_highway_envs(config):
    ours, theirs = ParkingVecEnv(config, 2), make_parking_env(config)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space


def test_until_the_first_reset_it_equals_highway_env_in_a_dummy_vec_env(config):
    """The same seeds, the same actions: observations, rewards, dones and infos, the last step of an
    episode included.
    """
    ours = ParkingVecEnv(config.for_training(), 4)
    theirs = DummyVecEnv([lambda: make_parking_env(config.for_training())] * 4)
    ours.seed(7), theirs.seed(7)
    start, their_start = ours.reset(), theirs.reset()
    rng = np.random.default_rng(0)
    for step in range(11):
        for key in start:
            np.testing.assert_array_equal(start[key], their_start[key])
        actions = rng.uniform(-1, 1, (4, 2)).astype(np.float32)
        start, rewards, dones, infos = ours.step(actions)
        their_start, their_rewards, their_dones, their_infos = theirs.step(actions)
        np.testing.assert_array_equal(rewards, their_rewards)
        assert rewards.dtype == their_rewards.dtype
        np.testing.assert_array_equal(dones, their_dones)
        assert dones.all() == (step == 10)
        for our_info, their_info in zip(infos, their_infos, strict=True):
            assert (our_info["is_success"], our_info["crashed"]) == (
                their_info["is_success"],
                their_info["crashed"],
            )
    for our_info, their_info in zip(infos, their_infos, strict=True):
        assert our_info["TimeLimit.truncated"] is True
        assert their_info["TimeLimit.truncated"] is True
        for key, value in their_info["terminal_observation"].items():
            np.testing.assert_array_equal(our_info["terminal_observation"][key], value)
    assert (ours.batch.state.steps == 0).all()  # of a new scene
    assert (start["observation"][:, :4] == 0).all()
    np.testing.assert_array_equal(start["desired_goal"], ours.batch.observe()["desired_goal"])


@pytest.mark.parametrize("option", ["parking", "parking_crowded"])
def test_state_is_saved_restored_and_continued_identically(option):
    config = compose(f"env={option}", "env.training_duration=4").env.for_training()
    env, other = ParkingVecEnv(config, 64), ParkingVecEnv(config, 64)
    env.seed(3)
    other.set_state(env.get_state())  # a seed that waits for its reset is part of the state
    np.testing.assert_array_equal(env.reset()["observation"], other.reset()["observation"])
    actions = np.clip(np.random.default_rng(0).normal(0.7, 0.5, (40, 64, 2)), -1, 1)
    for action in actions[:17]:
        env.step(action)
    other.set_state(env.get_state())
    n_crashes = 0
    for rewards, _, infos in step_alike(env, other, actions[17:]):
        crashed = np.array([info["crashed"] for info in infos])
        assert not any(info["TimeLimit.truncated"] for info in infos if info["crashed"])
        assert (rewards[crashed] < -5).all()
        n_crashes += crashed.sum()
    assert n_crashes > 0

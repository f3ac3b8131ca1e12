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
    return compose(
        "env.training_duration=2",
        "env.vehicles_count=[0,20]",
        "env.observation.vehicles_count=3",
        "env.observation.rays=8",
    ).env


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
    ours.seed(7)
    theirs.seed(7)
    np.testing.assert_equal(ours.reset(), theirs.reset())
    actions = np.random.default_rng(0).uniform(-1, 1, (11, 4, 2)).astype(np.float32)
    for _, dones, _ in step_alike(ours, theirs, actions[:10]):
        assert not dones.any()
    start, rewards, dones, infos = ours.step(actions[10])
    _, their_rewards, their_dones, their_infos = theirs.step(actions[10])
    np.testing.assert_array_equal(rewards, their_rewards, strict=True)
    assert dones.all()
    assert their_dones.all()
    for our_info, their_info in zip(infos, their_infos, strict=True):
        for name in ("is_success", "crashed", "TimeLimit.truncated", "terminal_observation"):
            np.testing.assert_equal(our_info[name], their_info[name])
    assert (ours.batch.state.steps == 0).all()  # of a new scene
    np.testing.assert_equal(start, ours.batch.observe())


def test_a_crash_ends_an_episode_before_its_time():
    config = compose("env=parking_crowded", "env.training_duration=4").env.for_training()
    envs = ParkingVecEnv(config, 64)
    envs.seed(3)
    envs.reset()
    n_crashes = 0
    for _ in range(20):
        _, rewards, dones, infos = envs.step(np.ones((64, 2), np.float32))
        crashed = np.array([info["crashed"] for info in infos])
        assert dones[crashed].all()
        assert (rewards[crashed] < -5).all()
        assert not any(info["TimeLimit.truncated"] for info in infos if info["crashed"])
        n_crashes += crashed.sum()
    assert n_crashes > 0

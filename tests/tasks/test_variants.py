"""The env variants are highway-env's, and differ in what they say."""

import gymnasium as gym
import highway_env
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from support.runs import parking_envs

from parking_exp.config.compose import compose
from parking_exp.config_model import TRAINING_SEEDS_START
from parking_exp.tasks.parking.geometry import SLOT_LENGTH_M, SLOT_WIDTH_M
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.parking.pose import pose_in_slot
from parking_exp.tasks.parking.reward import ParkingReward
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs
from parking_exp.training.seeds import derive_seeds

gym.register_envs(highway_env)
SCALES = [100, 100, 5, 5, 1, 1]
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (60, 2))


def trajectory(env, scene):
    env.reset(seed=scene)
    steps = []
    for action in ACTIONS:
        observation, reward, terminated, truncated, info = env.step(action)
        steps.append(
            (observation["observation"].tolist(), reward, terminated, truncated, info["is_success"])
        )
        if terminated or truncated:
            break
    return steps


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("option", parking_envs())
def test_every_env_passes_gymnasiums_checker(option):
    env = make_parking_env(compose(f"env={option}", "n_envs=1").env)
    check_env(env, skip_render_check=True)  # raises where something is wrong
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize(
    ("option", "their_id"),
    [
        ("parking", "parking-v0"),
        ("parking_crowded", "parking-parked-v0"),
        ("parking_action_repeat", "parking-ActionRepeat-v0"),
    ],
)
def test_variants_equal_highway_envs_own(option, their_id):
    config = compose(f"env={option}", "n_envs=1").env
    assert trajectory(make_parking_env(config), 3) == trajectory(gym.make(their_id), 3)


def test_success_of_parking_stop_means_parked():
    """Every pose that highway-env's own criterion accepts is inside the lines, straight and
    standing; and some are.
    """
    reward = ParkingReward(compose("env=parking_stop").env)
    rng, n = np.random.default_rng(0), 200_000
    off = (
        rng.uniform(-1, 1, (n, 4)) * [1.1, 1.6, 0.6, 0.2] * rng.random((n, 1))
    )  # to all sides, down to nothing
    x, y, speed, turn = off.T
    heading = np.pi / 2 + turn
    achieved = np.stack(
        [x, y, speed * np.cos(heading), speed * np.sin(heading), np.cos(heading), np.sin(heading)],
        1,
    )
    goal = np.array([4.0, 14.0, 0, 0, 0, 1])
    achieved[:, :2] += goal[:2]
    _, reached = reward(achieved / SCALES, goal / SCALES)
    slot = {
        "goal_position": goal[:2],
        "goal_heading": np.pi / 2,
        "slot_size": (SLOT_LENGTH_M, SLOT_WIDTH_M),
    }
    poses = [
        pose_in_slot(achieved[row, :2], heading[row], speed[row], **slot)
        for row in reached.nonzero()[0]
    ]
    assert len(poses) > 10_000
    assert all(pose.parked for pose in poses)


def test_a_sparse_step_costs_1_and_a_crash_the_collision_penalty_besides():
    env = make_parking_env(compose("env=parking_sparse").env)
    env.reset(seed=0)
    rewards = []
    terminated = False
    while not terminated:
        _, reward, terminated, _, info = env.step(np.array([1.0, 0.0]))
        rewards.append(reward)
    assert info["crashed"]
    assert (set(rewards[:-1]), rewards[-1]) == ({-1}, -21)


@pytest.mark.parametrize("simulator", ["vectorized", "highway_env"])
def test_success_in_training_may_be_closer_than_in_evaluation(simulator):
    """A car at 1.21 m beside the slot's centre: -0.11 by the root of 1.21 / 100."""
    config = compose("env.training_success_goal_reward=0.1", f"env.simulator={simulator}").env
    envs = make_training_envs(make_task(config), n_envs=1)
    goal = envs.reset()["desired_goal"]
    achieved = goal + np.array([0.0121, 0, 0, 0, 0, 0])
    for goal_reward, is_reached in (
        (envs.get_attr("goal_reward")[0], False),
        (ParkingReward(config), True),
    ):
        reward, reached = goal_reward(achieved, goal)
        assert (reward.item(), reached.item()) == (pytest.approx(-0.11), is_reached)
    if simulator == "highway_env":
        assert envs.venv.envs[0].unwrapped.config["success_goal_reward"] == 0.1


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1])
def test_training_and_evaluation_scenes_never_meet(seed):
    training_seeds = compose().env.training_seeds
    seeds = derive_seeds(seed, training_seeds)
    assert seeds.training_envs >= TRAINING_SEEDS_START
    assert 0 <= seeds.policy < 2**31
    assert derive_seeds(seed, training_seeds) == seeds
    assert derive_seeds(seed + 1, training_seeds).training_envs != seeds.training_envs

"""Parking simulated by highway-env itself: parking-v0, and other lots as `LotEnv`."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import OrderEnforcing

from parking_exp.tasks.env_batch import EnvBatch
from parking_exp.tasks.parking.geometry import SLOT_LENGTH_M, SLOT_WIDTH_M
from parking_exp.tasks.parking.nearby_vehicles import NearbyVehicles, RandomVehiclesCount
from parking_exp.tasks.parking.obstacles import RandomObstacles
from parking_exp.tasks.parking.parking_config import ENV_ID, ParkingConfig
from parking_exp.tasks.parking.pose import PoseInSlot, pose_in_slot
from parking_exp.tasks.parking.rays import Rays
from parking_exp.tasks.parking.reward import reward_of


class SparseReward(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Reward highway-env's success with 0, all else with -1 (Andrychowicz et al. 2017, section 4).

    `collision_reward` is still added to the step of a crash.
    """

    def __init__(self, env: gym.Env) -> None:
        # So that gymnasium can make the env again from its spec.
        gym.utils.RecordConstructorArgs.__init__(self)
        gym.Wrapper.__init__(self, env)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the env."""
        observation, _, terminated, truncated, info = self.env.step(action)
        reward = float(info["is_success"]) - 1.0
        reward += self.unwrapped.config["collision_reward"] * info["crashed"]
        return observation, reward, terminated, truncated, info

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: object
    ) -> np.ndarray:
        """Return 0 where the goal is reached and -1 elsewhere; goals are (6,) or (batch, 6)."""
        return self.unwrapped.goal_reward(achieved_goal, desired_goal)[0]


def make_parking_env(config: ParkingConfig, *, render_mode: str | None = None) -> gym.Env:
    """Make one parking env; `render_mode` is None or `rgb_array`."""
    env = _make_pose_env(config, render_mode)
    observation = config.observation
    if observation.vehicles_count:
        env = NearbyVehicles(env, observation.vehicles_count)
    if observation.rays:
        env = Rays(env, observation.rays, observation.rays_range_m)
    return env


def _make_pose_env(config: ParkingConfig, render_mode: str | None) -> gym.Env:
    """Make an env that shows the pose of the car only."""
    if config.lot_configs:
        from parking_exp.tasks.parking.lot_env import LotEnv

        return OrderEnforcing(LotEnv(config, render_mode))
    import highway_env  # imports pyplot and pygame, which the simulator does not need

    gym.register_envs(highway_env)
    # Gymnasium's checker tests every space at every step and costs time; our tests run it instead.
    env = gym.make(
        ENV_ID, config=config.highway_options(), render_mode=render_mode, disable_env_checker=True
    )
    env.unwrapped.goal_reward = reward_of(config)
    if config.reward == "sparse":
        env = SparseReward(env)
    if isinstance(config.vehicles_count, list):
        env = RandomVehiclesCount(env, *config.vehicles_range)
    if config.obstacles:
        env = RandomObstacles(env, config.obstacles)
    return env


def skip_unused_work(env: gym.Env) -> None:
    """Skip work that takes 80 % of highway-env's time but changes no episode, until a reset.

    Four times a step, highway-env makes two data frames to read the poses of a car and of its goal.
    Three times a step, it looks up the lane of each car, which parking does not use. Motion,
    collisions, rewards and the end of an episode stay highway-env's.
    """
    parking_env: Any = env.unwrapped
    for sensor in (parking_env.observation_type, parking_env.observation_type_parking):
        sensor.observe = partial(_observe, sensor)
    any_lane = parking_env.vehicle.lane_index
    parking_env.road.network.get_closest_lane_index = lambda *_: any_lane


def _observe(sensor: Any) -> dict[str, np.ndarray]:
    """Return what `KinematicsGoalObservation.observe` returns."""
    car = sensor.observer_vehicle
    pose = _scaled_features(sensor, car)
    return {
        "observation": pose,
        "achieved_goal": pose.copy(),
        "desired_goal": _scaled_features(sensor, car.goal),
    }


def _scaled_features(sensor: Any, road_object: Any) -> np.ndarray:
    """Return the features of a car or a goal, shape (6,)."""
    values = road_object.to_dict()
    return np.array([values[name] for name in sensor.features]) / sensor.scales


class HighwayBatch(EnvBatch):
    """n scenes of highway-env itself, an env for each, without autoreset."""

    def __init__(self, config: ParkingConfig, seeds: Sequence[int]) -> None:
        super().__init__([make_parking_env(config) for _ in seeds], seeds, "crashed")
        self.config = config
        for env in self.envs:
            skip_unused_work(env)

    def ending(self, row: int) -> PoseInSlot:
        """Return the pose of a car relative to its goal."""
        parking_env = self.envs[row].unwrapped
        car = parking_env.vehicle
        goal = car.goal.position, car.goal.heading
        slot_size = (SLOT_LENGTH_M, SLOT_WIDTH_M)
        if self.config.lot_configs:
            slot_size = parking_env.slot_size
        return pose_in_slot(car.position, car.heading, car.speed, *goal, slot_size)

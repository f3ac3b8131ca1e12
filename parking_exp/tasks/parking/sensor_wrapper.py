"""Base of wrappers that append what a sensor measures to the observation."""

from abc import ABC, abstractmethod
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class SensorWrapper(gym.ObservationWrapper, gym.utils.RecordConstructorArgs, ABC):
    """Base of wrappers that append a sensor's measurements to `observation` of a parking env of
    highway-env.

    Args:
        env: a parking env with the observation type KinematicsGoal, such as parking-v0.
        size: number of measurements that are appended.
    """

    def __init__(self, env: gym.Env, size: int) -> None:
        gym.ObservationWrapper.__init__(self, env)
        assert isinstance(env.observation_space, spaces.Dict)
        size += spaces.flatdim(env.observation_space["observation"])
        box = spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.observation_space = spaces.Dict(env.observation_space.spaces | {"observation": box})

    def observation(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the observation with the measurements."""
        entries = np.concatenate([observation["observation"], self.measure()])
        return observation | {"observation": entries}

    @abstractmethod
    def measure(self) -> np.ndarray:
        """Return the measurements, shape (size,)."""

    def find_others(self, *, walls: bool) -> list[Any]:
        """Return all vehicles except the car, and the obstacles, with or without walls."""
        from highway_env.vehicle.objects import Obstacle

        car = self.unwrapped.vehicle
        road = self.unwrapped.road
        others = [vehicle for vehicle in road.vehicles if vehicle is not car]
        for item in road.objects:
            # Walls are obstacles with a length of their own.
            if isinstance(item, Obstacle) and (walls or item.LENGTH == Obstacle.LENGTH):
                others.append(item)
        return others

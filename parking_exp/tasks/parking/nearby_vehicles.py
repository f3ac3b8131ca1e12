"""Observation of the nearest other vehicles; wrappers that add it and sample their number."""

from typing import Any

import gymnasium as gym
import numpy as np

from parking_exp.tasks.parking.highway_lot import sample_vehicles_count
from parking_exp.tasks.parking.parking_config import DEFAULT_SCALES
from parking_exp.tasks.parking.scenes import FAR_M
from parking_exp.tasks.parking.sensor_wrapper import SensorWrapper
from parking_exp.tasks.reset_rng import reset_rng

ENTRIES = ("presence", "x", "y", "cos_h", "sin_h")
"""Entries of each vehicle, with highway-env's names and scales.

x and y are relative to the car, along the axes of the lot.
"""


def nearest_vehicles(
    position: np.ndarray, others: np.ndarray, heading: np.ndarray, count: int
) -> np.ndarray:
    """Return each car's nearest vehicles, nearest first, shape (n, count * len(ENTRIES)).

    If there are fewer than `count` vehicles, the remaining entries are 0.

    Args:
        position: positions of the cars, shape (n, 2) [m].
        others: positions of the other vehicles, shape (n, vehicles, 2) [m].
        heading: headings of the other vehicles, shape (n, vehicles) [rad].
        count: number of vehicles that are seen.
    """
    offset = others - position[:, None]
    squared = offset[..., 0] ** 2 + offset[..., 1] ** 2
    nearest = np.argsort(squared, axis=1, kind="stable")[:, :count]
    rows = np.arange(len(position))[:, None]
    angle = heading[rows, nearest]
    seen = np.zeros((len(position), count, len(ENTRIES)))
    present = seen[:, : nearest.shape[1]]
    present[..., 0] = squared[rows, nearest] < FAR_M**2
    present[..., 1:3] = offset[rows, nearest] / DEFAULT_SCALES[:2]
    present[..., 3] = np.cos(angle)
    present[..., 4] = np.sin(angle)
    seen *= seen[..., :1]
    return seen.reshape(len(position), -1)


class NearbyVehicles(SensorWrapper):
    """Append the nearest vehicles and obstacles to `observation` of a parking env of highway-env.

    The observation gets 5 entries more for each vehicle, see `ENTRIES`; x and y are in 100 m,
    whatever the scales are. Goals stay as they are.

    Args:
        env: highway-env's parking-v0 with the observation type KinematicsGoal, for example
            `gym.make("parking-v0", config={"vehicles_count": 10})`.
        vehicles_count: number of vehicles that are seen, nearest first.
    """

    def __init__(self, env: gym.Env, vehicles_count: int) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, vehicles_count=vehicles_count)
        super().__init__(env, vehicles_count * len(ENTRIES))
        self.vehicles_count = vehicles_count

    def measure(self) -> np.ndarray:
        """Return the nearest vehicles."""
        car = self.unwrapped.vehicle
        others = self.find_others(walls=False)
        positions = np.array([vehicle.position for vehicle in others]).reshape(1, -1, 2)
        headings = np.array([[vehicle.heading for vehicle in others]])
        return nearest_vehicles(car.position[None], positions, headings, self.vehicles_count)[0]


class RandomVehiclesCount(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Sample `vehicles_count` at each reset, uniform from `low` to `high`.

    See `sample_vehicles_count`.
    """

    def __init__(self, env: gym.Env, low: int, high: int) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, low=low, high=high)
        gym.Wrapper.__init__(self, env)
        self.low = low
        self.high = high

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        rng = reset_rng(self, seed)
        vehicles_count = sample_vehicles_count(rng.bit_generator, self.low, self.high)
        options = dict(options or {})
        options["config"] = {**options.get("config", {}), "vehicles_count": vehicles_count}
        return self.env.reset(seed=seed, options=options)

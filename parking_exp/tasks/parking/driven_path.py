"""Driven paths of evaluation episodes: length, changes of gear, and the shortest path instead."""

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, REAR_AXLE_M
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.simulator.scene_state import SCALES
from parking_exp.tasks.task import EvaluationBatch, Observation, Step

STANDING_MPS = 0.1
"""A slower car keeps its gear, so that trembling at rest does not count."""


class DrivenBatch(EvaluationBatch):
    """Episodes of parking whose `info` also describes the driven path.

    It is the path of the middle of the rear axle, which moves in the direction of the heading.
    Between policy steps, it is assumed to be straight.

    Args:
        batch: the episodes; their first six observations are the car's pose.
        config: the env's config.
    """

    def __init__(self, batch: EvaluationBatch, config: ParkingConfig) -> None:
        self.batch = batch
        _, (low, high) = config.action.ranges
        # At steering d, the car slips at its middle by atan(tan(d) / 2).
        self._radius_m = CAR_LENGTH_M / math.tan(max(-low, high))
        self._step_s = 1 / config.policy_frequency
        self._start, _ = _rear_axle(batch.observe())
        self._pose = self._start
        n = len(batch)
        self._path_m = np.zeros(n)
        self._gear = np.zeros(n)
        self._gear_changes = np.zeros(n, np.int64)
        self._steps = 0

    def __len__(self) -> int:
        return len(self.batch)

    def observe(self) -> Observation:
        """Return the observations of all episodes."""
        return self.batch.observe()

    def step(self, actions: np.ndarray) -> Step:
        """Step all episodes; actions have the shape (n, 2)."""
        step = self.batch.step(actions)
        pose, speed = _rear_axle(step.observation)
        moved = pose[:, :2] - self._pose[:, :2]
        self._path_m += np.hypot(*moved.T)
        self._pose = pose

        gear = np.where(np.abs(speed) < STANDING_MPS, self._gear, np.sign(speed))
        self._gear_changes += gear * self._gear < 0
        self._gear = gear
        self._steps += 1
        return step

    def keep(self, rows: np.ndarray) -> None:
        """Keep only some of the episodes, by mask."""
        self.batch.keep(rows)
        self._start = self._start[rows]
        self._pose = self._pose[rows]
        self._path_m = self._path_m[rows]
        self._gear = self._gear[rows]
        self._gear_changes = self._gear_changes[rows]

    def ending(self, row: int) -> Any:
        """Return the pose of a car relative to its goal."""
        return self.batch.ending(row)

    def info(self, row: int) -> Mapping[str, Any]:
        """Return the last `info` of an episode, and `time_s`, `path_m`, `gear_changes` and
        `shortest_path_m` from where it started to where it ended.
        """
        shortest_path_m = reeds_shepp_m(
            self._start[row].tolist(), self._pose[row].tolist(), self._radius_m
        )
        return {
            **self.batch.info(row),
            "time_s": self._steps * self._step_s,
            "path_m": float(self._path_m[row]),
            "gear_changes": int(self._gear_changes[row]),
            "shortest_path_m": shortest_path_m,
        }


def reeds_shepp_m(start: list[float], end: list[float], radius_m: float) -> float:
    """Return the length of the shortest path of a car between two poses of its rear axle [m].

    Nothing is in its way (Reeds and Shepp 1990). It is NaN without OMPL, `parking-exp[planning]`.

    Args:
        start, end: x, y and heading, shape (3,) [m, m, rad].
        radius_m: the smallest radius of its turns.
    """
    space = _reeds_shepp_space(radius_m)
    if space is None:
        return math.nan
    states = []
    for x, y, heading in (start, end):
        state = space.allocState()
        state.setX(x)
        state.setY(y)
        state.setYaw(heading)
        states.append(state)
    return float(space.distance(*states))


@cache
def _reeds_shepp_space(radius_m: float) -> Any:
    if radius_m <= 0:  # wheels that turn by more than 90 degrees
        return None
    try:
        from ompl import base
    except ImportError:
        return None
    return base.ReedsSheppStateSpace(radius_m)


def _rear_axle(observation: Observation) -> tuple[np.ndarray, np.ndarray]:
    """Return rear axles, x, y, heading, shape (n, 3) [m, m, rad], and speeds, (n,) [m/s]."""
    x, y, vx, vy, cos, sin = (observation["observation"][:, : len(SCALES)] * SCALES).T
    pose = np.stack([x - REAR_AXLE_M * cos, y - REAR_AXLE_M * sin, np.arctan2(sin, cos)], axis=1)
    return pose, vx * cos + vy * sin

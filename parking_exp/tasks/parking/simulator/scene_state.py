"""State of many scenes as arrays."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from parking_exp.tasks.parking.geometry import direction_of
from parking_exp.tasks.parking.parking_config import DEFAULT_FEATURES, DEFAULT_SCALES
from parking_exp.tasks.parking.scenes import Scenes

SCALES = np.array(DEFAULT_SCALES, np.float64)
STORED_BY_COLUMN = ("position", "direction", "free")
# What collisions and driving change.
MOVING = (
    "position",
    "heading",
    "direction",
    "speed",
    "crashed",
    "vehicles",
    "hit",
    "impact",
    "pushed",
)


@dataclass
class SceneState:
    """The complete state of n scenes.

    Arrays have a row for each scene; those in `STORED_BY_COLUMN` have a column.
    """

    goal: np.ndarray  # pose of the goal slots, shape (n, 3) [m, m, rad]
    # x, y, vx, vy, cos_h, sin_h of the goals in units of the observation, shape (n, 6)
    goal_features: np.ndarray
    slot_size: np.ndarray  # length and width of the goal slots, shape (n, 2) [m]
    free: np.ndarray  # half the space between the walls' inner faces, shape (2, n) [m]
    position: np.ndarray  # x and y of the cars, shape (2, n) [m]
    heading: np.ndarray  # shape (n,) [rad]
    direction: np.ndarray  # its cosine and sine, shape (2, n)
    speed: np.ndarray  # signed, shape (n,) [m/s]
    crashed: np.ndarray  # shape (n,)
    steps: np.ndarray  # policy steps since the start, shape (n,)
    # Positions of the parked cars, shape (n, vehicles, 2) [m]; missing ones are far away.
    vehicles: np.ndarray
    vehicle_heading: np.ndarray  # shape (n, vehicles) [rad]
    obstacles: np.ndarray  # places of the obstacles, shape (n, obstacles, 2) [m]
    # Whether `impact` applies in the next frame, shape (n, 1 + vehicles); first the car itself.
    hit: np.ndarray
    # Displacements by predicted collisions, in the same order, shape (n, 1 + vehicles, 2) [m].
    impact: np.ndarray
    pushed: np.ndarray  # whether parked cars have ever been displaced, shape (n, vehicles)

    @classmethod
    def at_start(cls, scenes: Scenes) -> Self:
        """Return the state in which scenes start."""
        n, count = scenes.vehicles.shape
        goal = scenes.goal_pose
        standing = np.zeros(n)
        vehicle_pose = scenes.vehicle_pose
        return cls(
            goal=goal,
            goal_features=scaled_features(goal[:, :2].T, direction_of(goal[:, 2]), standing),
            slot_size=scenes.slot_size.copy(),
            free=scenes.free,
            position=scenes.start[:, :2].T.copy(),
            heading=scenes.heading.copy(),
            direction=direction_of(scenes.heading),
            speed=standing,
            crashed=np.zeros(n, bool),
            steps=np.zeros(n, np.int64),
            vehicles=vehicle_pose[..., :2],
            vehicle_heading=vehicle_pose[..., 2],
            obstacles=scenes.obstacles.copy(),
            hit=np.zeros((n, 1 + count), bool),
            impact=np.zeros((n, 1 + count, 2)),
            pushed=np.zeros((n, count), bool),
        )

    def take(self, rows: np.ndarray) -> Self:
        """Return the state of some scenes, by index, as a copy."""
        return type(self)(
            **{
                name: array.take(rows, axis=int(name in STORED_BY_COLUMN))
                for name, array in vars(self).items()
            }
        )

    def put(self, rows: np.ndarray, other: Self, names: Iterable[str] | None = None) -> None:
        """Replace the state of some scenes, or only what is named."""
        for name in names or vars(self):
            array = getattr(self, name)
            array[(slice(None), rows) if name in STORED_BY_COLUMN else rows] = getattr(other, name)


def scaled_features(position: np.ndarray, direction: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Return x, y, vx, vy, cos_h, sin_h in units of the observation, shape (n, 6).

    Args:
        position, direction: of cars or goals, shape (2, n) [m].
        speed: shape (n,) [m/s].
    """
    features = np.empty((len(DEFAULT_FEATURES), len(speed)))
    features[:2] = position
    features[4:] = direction
    np.multiply(speed, direction, out=features[2:4])
    features /= SCALES[:, None]
    return np.ascontiguousarray(features.T)

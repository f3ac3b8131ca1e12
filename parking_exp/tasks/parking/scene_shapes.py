"""Rectangles of a scene, for drawings: slots, cars, walls and obstacles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from parking_exp.tasks.parking.geometry import CAR_SIZE_M, OBSTACLE_SIZE_M, walls_around
from parking_exp.tasks.parking.scenes import NO_SLOT, Scenes


class Rectangle(NamedTuple):
    """A rectangle with a direction."""

    x: float  # of its centre [m]
    y: float
    heading: float  # [rad]
    length: float  # along the heading [m]
    width: float  # across it


@dataclass(frozen=True)
class SceneShapes:
    """The rectangles of a scene."""

    car: Rectangle
    goal: Rectangle  # the goal's slot
    slots: Sequence[Rectangle]
    parked_cars: Sequence[Rectangle]
    walls: Sequence[Rectangle]
    obstacles: Sequence[Rectangle]


def scene_shapes(scenes: Scenes, row: int, *, walls: bool) -> SceneShapes:
    """Return the rectangles of one scene at its start; without walls, there are none."""
    slots = _rectangles(scenes.slots[row], scenes.slot_size[row])
    cars = scenes.vehicle_pose[row][scenes.vehicles[row] != NO_SLOT]
    (car,) = _rectangles(scenes.start[[row]], CAR_SIZE_M)
    obstacles = np.insert(scenes.obstacles[row], 2, 0.0, axis=1)  # their headings
    return SceneShapes(
        car=car,
        goal=slots[scenes.goal[row]],
        slots=slots,
        parked_cars=_rectangles(cars, CAR_SIZE_M),
        walls=_walls(scenes.free[:, [row]]) if walls else [],
        obstacles=_rectangles(obstacles, OBSTACLE_SIZE_M),
    )


def _walls(free: np.ndarray) -> list[Rectangle]:
    """Return the walls around half a space of shape (2, 1) [m]."""
    walls = walls_around(free)
    poses = np.column_stack([walls.centre[0], walls.heading[0]])
    return _rectangles(poses, walls.size[0])


def _rectangles(poses: np.ndarray, size: np.ndarray | tuple[float, float]) -> list[Rectangle]:
    """Return n rectangles; poses have the shape (n, 3), their sizes (n, 2) or (2,)."""
    sizes = np.broadcast_to(size, (len(poses), 2))
    return [Rectangle(*values) for values in np.column_stack([poses, sizes]).tolist()]

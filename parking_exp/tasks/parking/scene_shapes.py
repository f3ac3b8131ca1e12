"""Rectangles of a scene, for drawings: slots, cars, walls and obstacles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.parking.geometry import CAR_SIZE_M, OBSTACLE_SIZE_M, walls_around
from parking_exp.tasks.parking.scenes import NO_SLOT, Scenes


@dataclass(frozen=True)
class SceneShapes:
    """The rectangles of a scene.

    Each is x and y of its centre, its heading, length and width [m, m, rad, m, m]. Those of several
    things have the shape (n, 5).
    """

    car: np.ndarray
    goal: np.ndarray  # the goal's slot
    slots: np.ndarray
    parked_cars: np.ndarray
    walls: np.ndarray
    obstacles: np.ndarray


def scene_shapes(scenes: Scenes, row: int, *, walls: bool) -> SceneShapes:
    """Return the rectangles of one scene at its start; without walls, there are none."""
    slots = _rectangles(scenes.slots[row], scenes.slot_size[row])
    cars = scenes.vehicle_pose[row][scenes.vehicles[row] != NO_SLOT]
    obstacles = np.insert(scenes.obstacles[row], 2, 0.0, axis=1)  # their headings
    around = walls_around(scenes.free[:, [row]])
    wall_poses = np.column_stack([around.centre[0], around.heading[0]])
    of_walls = _rectangles(wall_poses, around.size[0])
    return SceneShapes(
        car=_rectangles(scenes.start[row], CAR_SIZE_M),
        goal=slots[scenes.goal[row]],
        slots=slots,
        parked_cars=_rectangles(cars, CAR_SIZE_M),
        walls=of_walls if walls else of_walls[:0],
        obstacles=_rectangles(obstacles, OBSTACLE_SIZE_M),
    )


def _rectangles(poses: np.ndarray, size: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return rectangles, shape (..., 5); poses have the shape (..., 3), sizes (..., 2) or (2,)."""
    sizes = np.broadcast_to(size, (*poses.shape[:-1], 2))
    return np.concatenate([poses, sizes], axis=-1)

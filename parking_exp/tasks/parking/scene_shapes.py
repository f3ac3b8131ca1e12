"""Rectangles of a scene, for drawings: slots, cars, walls and obstacles."""

from collections.abc import Sequence

import numpy as np

from parking_exp.tasks.parking.geometry import CAR_SIZE_M, OBSTACLE_SIZE_M, walls_around
from parking_exp.tasks.parking.scenes import NO_SLOT, Scenes


def scene_shapes(scenes: Scenes, row: int, *, walls: bool) -> dict[str, np.ndarray]:
    """Return the rectangles of one scene at its start, by name.

    Each is x and y of its centre, its heading, length and width [m, m, rad, m, m]. `car` and
    `goal`, its slot, have the shape (5,). `slots`, `parked_cars`, `walls` and `obstacles` have the
    shape (n, 5). If `walls` is False, there are no walls in the result.
    """
    slots = _with_sizes(scenes.slots[row], scenes.slot_size[row])
    cars = scenes.vehicle_pose[row][scenes.vehicles[row] != NO_SLOT]
    obstacles = np.insert(scenes.obstacles[row], 2, 0.0, axis=1)  # their headings
    around = walls_around(scenes.free[:, [row]])
    wall_poses = np.column_stack([around.centre[0], around.heading[0]])
    wall_shapes = _with_sizes(wall_poses, around.size[0])
    return {
        "car": _with_sizes(scenes.start[row], CAR_SIZE_M),
        "goal": slots[scenes.goal[row]],
        "slots": slots,
        "parked_cars": _with_sizes(cars, CAR_SIZE_M),
        "walls": wall_shapes if walls else wall_shapes[:0],
        "obstacles": _with_sizes(obstacles, OBSTACLE_SIZE_M),
    }


def _with_sizes(poses: np.ndarray, size: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return rectangles, shape (..., 5); poses have the shape (..., 3), sizes (..., 2) or (2,)."""
    sizes = np.broadcast_to(size, (*poses.shape[:-1], 2))
    return np.concatenate([poses, sizes], axis=-1)

"""Free space of a scene: the poses in which a car touches no parked car, obstacle or wall."""

import numpy as np

from parking_exp.tasks.parking.geometry import (
    CAR_SIZE_M,
    REAR_AXLE_M,
    cars_at,
    direction_of,
    extent,
    join_rectangles,
    may_overlap,
    move_ahead,
    obstacles_at,
)
from parking_exp.tasks.parking.scenes import Scenes


class FreeSpace:
    """Where a car keeps its distance from all parked cars, obstacles and walls.

    Args:
        scenes: one scene.
        walls: whether there are walls around the lot.
        margin_m: the distance to keep, on all sides of the car.
    """

    def __init__(self, scenes: Scenes, *, walls: bool, margin_m: float = 0.0) -> None:
        self.free = scenes.free  # half the space between the walls, shape (2, 1) [m]
        self._walls = walls
        self._margin_m = margin_m
        vehicles = scenes.vehicle_pose
        parked_cars = cars_at(vehicles[..., :2], vehicles[..., 2])
        others = join_rectangles([parked_cars, obstacles_at(scenes.obstacles)])
        # Shape (2, 1, others): x and y, or length and width. Axis 1 is for the car's poses.
        self._centre = others.centre.T.swapaxes(1, 2)
        self._direction = direction_of(others.heading)
        self._half_size = others.size.T.swapaxes(1, 2) / 2

    def contains(self, poses: np.ndarray) -> bool:
        """Return whether a car fits at all poses of its rear axle, shape (n, 3) [m, m, rad]."""
        x, y, heading = move_ahead(poses, REAR_AXLE_M).T
        position = np.stack([x, y])
        direction = direction_of(heading)
        if self._walls:
            reach = np.abs(position) + extent(direction, self._margin_m)
            if (reach > self.free).any():
                return False
        overlaps = may_overlap(
            self._centre - position[..., None],
            direction[..., None],
            np.array(CAR_SIZE_M).reshape(2, 1, 1) / 2 + self._margin_m,
            self._direction,
            self._half_size,
        )
        return not overlaps.any()

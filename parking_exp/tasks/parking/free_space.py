"""Free space of a scene: the poses in which a car touches no parked car, obstacle or wall."""

import numpy as np

from parking_exp.tasks.parking.driven_path import REAR_AXLE_M, moved_ahead
from parking_exp.tasks.parking.geometry import (
    CAR_SIZE_M,
    cars_at,
    direction_of,
    extent,
    joined,
    may_overlap,
    obstacles_at,
)
from parking_exp.tasks.parking.scenes import Scenes


class FreeSpace:
    """Where a car keeps its distance from all parked cars, obstacles and walls.

    Args:
        scenes: n scenes.
        walls: whether there are walls around the lot.
        margin_m: the distance to keep, on all sides of the car.
    """

    def __init__(self, scenes: Scenes, *, walls: bool, margin_m: float = 0.0) -> None:
        self.half_box = scenes.free  # half the space between the walls, shape (2, n) [m]
        self._walls = walls
        self._margin_m = margin_m
        vehicles = scenes.vehicle_pose
        parked_cars = cars_at(vehicles[..., :2], vehicles[..., 2])
        self._others = joined([parked_cars, obstacles_at(scenes.obstacles)])

    def touches(self, poses: np.ndarray) -> np.ndarray:
        """Return where a car is too close to something.

        Args:
            poses: poses of the middle of the car in each scene, shape (n, poses, 3) [m, m, rad].

        Returns:
            A mask, shape (n, poses).
        """
        # The axes are x and y, or length and width; scenes; poses; others.
        others = self._others
        position = np.moveaxis(poses[..., :2], -1, 0)
        direction = direction_of(poses[..., 2])
        centre = np.moveaxis(others.centre, -1, 0)[:, :, None]
        overlaps = may_overlap(
            centre - position[..., None],
            direction[..., None],
            np.array(CAR_SIZE_M).reshape(2, 1, 1, 1) / 2 + self._margin_m,
            direction_of(others.heading)[:, :, None],
            np.moveaxis(others.size, -1, 0)[:, :, None] / 2,
        )
        touching = np.asarray(overlaps.any(axis=-1))
        if self._walls:
            beyond = np.abs(position) + extent(direction, self._margin_m)
            touching |= (beyond > self.half_box[..., None]).any(axis=0)
        return touching

    def contains(self, poses: np.ndarray) -> bool:
        """Return whether a car fits at all poses of its rear axle in the only scene.

        Poses have the shape (n, 3) [m, m, rad].
        """
        centres = moved_ahead(poses, REAR_AXLE_M)
        return not self.touches(centres[None]).any()

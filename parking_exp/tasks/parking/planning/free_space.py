"""Free space of a scene: the poses in which a car touches nothing."""

import numpy as np

from parking_exp.tasks.parking.driven_path import REAR_AXLE_M
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, CAR_WIDTH_M, corners
from parking_exp.tasks.parking.scene_shapes import Rectangle, scene_shapes
from parking_exp.tasks.parking.scenes import Scenes
from parking_exp.tasks.parking.simulator.collisions import separating_axis


class FreeSpace:
    """The poses in which a car keeps its distance from all parked cars, obstacles and walls.

    Args:
        scenes: which have the scene.
        row: its number.
        walls: whether there are walls around the lot.
        margin_m: the distance to keep.
    """

    def __init__(self, scenes: Scenes, row: int, *, walls: bool, margin_m: float) -> None:
        self.half_box = scenes.free[:, row]  # half the space between the walls [m]
        self._walls = walls
        self._length = CAR_LENGTH_M + 2 * margin_m
        self._width = CAR_WIDTH_M + 2 * margin_m

        shapes = scene_shapes(scenes, row, walls=False)
        others: list[Rectangle] = [*shapes.parked_cars, *shapes.obstacles]
        rectangles = np.array(others).reshape(-1, len(Rectangle._fields))
        x, y, heading, length, width = rectangles.T
        self._centres = np.stack([x, y], axis=-1)
        direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        self._corners = corners(self._centres, direction, length, width)
        self._reach = (np.hypot(self._length, self._width) + np.hypot(length, width)) / 2

    def contains(self, poses: np.ndarray) -> bool:
        """Return whether a car fits at all poses of its rear axle, shape (n, 3) [m, m, rad]."""
        heading = poses[:, 2]
        direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        centres = poses[:, :2] + REAR_AXLE_M * direction
        cars = corners(centres, direction, self._length, self._width)
        if self._walls and (np.abs(cars) > self.half_box).any():
            return False

        offset = self._centres - centres[:, None]
        car, other = np.nonzero((offset**2).sum(axis=-1) < self._reach**2)
        if not len(car):
            return True
        pairs = np.stack([cars[car], self._corners[other]], axis=1)
        touching, _, _ = separating_axis(pairs, np.zeros((len(pairs), 2)))
        return not touching.any()

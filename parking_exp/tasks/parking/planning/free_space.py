"""Free space of a scene: the poses in which a car touches nothing."""

import numpy as np

from parking_exp.tasks.parking.contacts import touches
from parking_exp.tasks.parking.driven_path import REAR_AXLE_M, moved_ahead
from parking_exp.tasks.parking.scenes import Scenes


class FreeSpace:
    """The poses in which a car keeps its distance from all parked cars, obstacles and walls.

    Args:
        scene: one scene.
        walls: whether there are walls around the lot.
        margin_m: the distance to keep.
    """

    def __init__(self, scene: Scenes, *, walls: bool, margin_m: float) -> None:
        self.half_box = scene.free[:, 0]  # half the space between the walls [m]
        self._scene = scene
        self._walls = walls
        self._margin_m = margin_m

    def contains(self, poses: np.ndarray) -> bool:
        """Return whether a car fits at all poses of its rear axle, shape (n, 3) [m, m, rad]."""
        centres = moved_ahead(poses, REAR_AXLE_M)
        touching = touches(self._scene, centres[None], walls=self._walls, margin_m=self._margin_m)
        return not touching.any()

"""Contacts of a standing car with parked cars, obstacles and walls."""

import numpy as np

from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, CAR_WIDTH_M, OBSTACLE_M
from parking_exp.tasks.parking.nearby_vehicles import FAR_M
from parking_exp.tasks.parking.scenes import NO_SLOT, Scenes

CAR = (CAR_LENGTH_M, CAR_WIDTH_M)
OBSTACLE = (OBSTACLE_M, OBSTACLE_M)

Size = tuple[float, float]
"""Length and width of a rectangle [m]."""


def touches(scenes: Scenes, poses: np.ndarray, *, walls: bool, margin_m: float = 0.0) -> np.ndarray:
    """Return where a car is closer than a margin to a parked car, an obstacle or a wall.

    Args:
        scenes: n scenes.
        poses: of the middle of the car in each scene, shape (n, poses, 3) [m, m, rad].
        walls: whether there are walls around the lot.
        margin_m: added on all sides of the car.

    Returns:
        A mask, shape (n, poses).
    """
    size = (CAR_LENGTH_M + 2 * margin_m, CAR_WIDTH_M + 2 * margin_m)
    vehicles = scenes.vehicle_pose
    vehicles[scenes.vehicles == NO_SLOT, 0] = FAR_M
    obstacles = np.zeros((*scenes.obstacles.shape[:2], 3))
    obstacles[..., :2] = scenes.obstacles

    touching = np.zeros(poses.shape[:2], bool)
    for others, other_size in ((vehicles, CAR), (obstacles, OBSTACLE)):
        overlaps = _overlap(poses[:, :, None], size, others[:, None], other_size)
        touching |= overlaps.any(axis=2)
    if walls:
        reach = _half_extent(size, poses[..., 2])
        for axis in range(2):
            touching |= np.abs(poses[..., axis]) + reach[axis] > scenes.free[axis][:, None]
    return touching


def _overlap(pose: np.ndarray, size: Size, other: np.ndarray, other_size: Size) -> np.ndarray:
    """Return where two rectangles overlap, by the separating axis theorem.

    Poses have shapes that broadcast to (..., 3), the result has the shape (...).
    """
    offset = pose[..., :2] - other[..., :2]
    turn = pose[..., 2] - other[..., 2]
    overlaps = np.ones(turn.shape, bool)
    for seen_from, own_size, seen_size in ((pose, size, other_size), (other, other_size, size)):
        heading = seen_from[..., 2]
        ahead = offset[..., 0] * np.cos(heading) + offset[..., 1] * np.sin(heading)
        side = offset[..., 1] * np.cos(heading) - offset[..., 0] * np.sin(heading)
        half = _half_extent(seen_size, turn)
        overlaps &= np.abs(ahead) < own_size[0] / 2 + half[0]
        overlaps &= np.abs(side) < own_size[1] / 2 + half[1]
    return overlaps


def _half_extent(size: Size, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return half the extent of a turned rectangle along both axes, each of the shape of `turn`."""
    length, width = size
    cos = np.abs(np.cos(turn))
    sin = np.abs(np.sin(turn))
    return (length * cos + width * sin) / 2, (length * sin + width * cos) / 2

"""Contacts of a standing car with parked cars, obstacles and walls."""

import numpy as np

from parking_exp.tasks.parking.geometry import (
    CAR_SIZE_M,
    cars_at,
    extent,
    joined,
    may_overlap,
    obstacles_at,
)
from parking_exp.tasks.parking.nearby_vehicles import FAR_M
from parking_exp.tasks.parking.scenes import NO_SLOT, Scenes


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
    vehicles = scenes.vehicle_pose
    vehicles[scenes.vehicles == NO_SLOT, 0] = FAR_M
    parked_cars = cars_at(vehicles[..., :2], vehicles[..., 2])
    others = joined([parked_cars, obstacles_at(scenes.obstacles)])

    # The axes are x and y, or length and width; scenes; poses; others.
    position = np.moveaxis(poses[..., :2], -1, 0)
    direction = np.array([np.cos(poses[..., 2]), np.sin(poses[..., 2])])
    centre = np.moveaxis(others.centre, -1, 0)[:, :, None]
    other_direction = np.array([np.cos(others.heading), np.sin(others.heading)])[:, :, None]
    half_size = np.array(CAR_SIZE_M).reshape(2, 1, 1, 1) / 2 + margin_m
    other_half_size = np.moveaxis(others.size, -1, 0)[:, :, None] / 2
    overlaps = may_overlap(
        centre - position[..., None],
        direction[..., None],
        half_size,
        other_direction,
        other_half_size,
    )
    touching = np.asarray(overlaps.any(axis=-1))
    if walls:
        beyond = np.abs(position) + extent(direction, margin_m) > scenes.free[..., None]
        touching |= np.logical_or(*beyond)
    return touching

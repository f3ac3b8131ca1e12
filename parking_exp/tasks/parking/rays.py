"""Observe distances along rays, as a lidar does; with the Gymnasium wrapper that adds them."""

import gymnasium as gym
import numpy as np

from parking_exp.tasks.parking.geometry import Rectangles, direction_of, in_frame
from parking_exp.tasks.parking.parking_config import RAYS_RANGE_M
from parking_exp.tasks.parking.sensor_wrapper import SensorWrapper

_SMALLEST_SLOPE = 1e-300  # in place of 0, which can't be divided by


def ray_distances(
    position: np.ndarray, direction: np.ndarray, rectangles: Rectangles, rays: int, range_m: float
) -> np.ndarray:
    """Return distances from cars' centres along rays to the nearest rectangle, shape (n, rays) [m].

    Ray k has the angle k * 2 pi / rays to the car's heading, counter-clockwise: the first looks
    straight ahead. A distance is `range_m` where nothing is nearer, and 0 within a rectangle.

    Args:
        position: centres of the cars, shape (2, n) [m].
        direction: cosine and sine of their headings, shape (2, n).
        rectangles: all that is in the scenes but for the cars, of shape (n, R).
        rays: their number.
        range_m: the largest distance that is seen [m].
    """
    axis = direction_of(rectangles.heading)
    half_size = np.moveaxis(rectangles.size, -1, 0) / 2
    offset = in_frame(position[..., None] - np.moveaxis(rectangles.centre, -1, 0), axis)
    outside = np.maximum(np.abs(offset) - half_size, 0.0)
    near = (outside**2).sum(axis=0) < range_m**2
    scene, _ = np.nonzero(near)

    # In the frame of each rectangle that is near, a ray is for a while between the long sides, and
    # for a while between the short sides. It meets the rectangle when both hold.
    angle = np.arange(rays) * (2 * np.pi / rays)
    heading = in_frame(direction[:, scene], axis[:, near])
    slope = in_frame(heading[..., None], direction_of(-angle)[:, None])
    slope[slope == 0] = _SMALLEST_SLOPE
    metres = np.divide(1.0, slope, out=slope)  # along the ray, for one along or across
    middle = metres * -offset[:, near, None]
    half = np.abs(metres, out=metres)
    half *= half_size[:, near, None]
    enters = np.maximum.reduce(middle - half).clip(0.0, range_m)
    leaves = np.minimum.reduce(middle + half)
    enters[enters > leaves] = range_m

    distances = np.full((position.shape[1], rays), range_m, np.float64)
    seeing, first = np.unique(scene, return_index=True)  # pairs are in the order of scenes
    distances[seeing] = np.minimum.reduceat(enters, first, axis=0)
    return distances


class Rays(SensorWrapper):
    """Append distances along rays to `observation` of a parking env of highway-env.

    They are the distances from the car's centre to the nearest vehicle, wall or obstacle, as
    fractions of the range: 1 where there is none; see `ray_distances`. Goals stay as they are.

    Args:
        env: highway-env's parking-v0 with the observation type KinematicsGoal, for example
            `gym.make("parking-v0", config={"vehicles_count": 10})`, or `NearbyVehicles` around it.
        rays: their number, in equal angles all around the car, the first straight ahead.
        range_m: the largest distance that is seen [m].
    """

    def __init__(self, env: gym.Env, rays: int, range_m: float = RAYS_RANGE_M) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, rays=rays, range_m=range_m)
        super().__init__(env, rays)
        self.rays = rays
        self.range_m = range_m

    def measure(self) -> np.ndarray:
        """Return the distances along rays."""
        car = self.unwrapped.vehicle
        others = self.find_others(walls=True)
        sizes = [(item.LENGTH, item.WIDTH) for item in others]
        rectangles = Rectangles(
            centre=np.reshape([item.position for item in others], (1, -1, 2)),
            heading=np.reshape([item.heading for item in others], (1, -1)),
            size=np.reshape(sizes, (1, -1, 2)),
        )
        distances = ray_distances(
            car.position[:, None], car.direction[:, None], rectangles, self.rays, self.range_m
        )
        return distances[0] / self.range_m

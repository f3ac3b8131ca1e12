"""Obstacles between the rows of slots: highway-env's `Obstacle`, squares of 2 m, at random places."""

from typing import Any

import gymnasium as gym
import numpy as np

OBSTACLE_M = 2.0
OBSTACLE_DIAGONAL_M = float(np.sqrt(2 * OBSTACLE_M**2))
AISLE_M = np.array([33.0, 8.5])  # half the length and width of the area: within the walls, outside of the slots
START_M = 6.0  # distance from the middle of the lot, where the car starts


def drawn_places(rng: np.random.Generator, n: int) -> np.ndarray:
    """Draw n places of obstacles, shape (n, 2) [m]: uniform in the aisle, but not where the car starts."""
    places = np.empty((0, 2))
    while len(places) < n:
        drawn = rng.uniform(-AISLE_M, AISLE_M, (n, 2))
        places = np.concatenate([places, drawn[np.sqrt((drawn**2).sum(axis=1)) > START_M]])
    return places[:n]


def places_of_scene(bit_generator: Any, n: int) -> np.ndarray:
    """Return the places of a scene's obstacles, without using up its random generator.

    They are drawn by that generator, jumped twice: `env.reset(seed=s)` has
    `drawn_places(Generator(PCG64(SeedSequence(s)).jumped(2)), n)`.
    """
    return drawn_places(np.random.Generator(bit_generator.jumped(2)), n)


class RandomObstacles(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Put obstacles on the lot of parking-v0 at each reset; see `places_of_scene`.

    Args:
        env: highway-env's parking-v0. `NearbyVehicles` around this wrapper shows them.
        obstacles: their number.
    """

    def __init__(self, env: gym.Env, obstacles: int) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, obstacles=obstacles)
        gym.Wrapper.__init__(self, env)
        self.obstacles = obstacles

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        from highway_env.vehicle.objects import Obstacle

        rng = self.unwrapped.np_random if seed is None else gym.utils.seeding.np_random(seed)[0]
        places = places_of_scene(rng.bit_generator, self.obstacles)
        result = self.env.reset(seed=seed, options=options)
        road = self.unwrapped.road
        road.objects += [Obstacle(road, place) for place in places]
        return result

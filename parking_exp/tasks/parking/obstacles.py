"""Obstacles between the rows of slots: highway-env's `Obstacle`, 2 m squares at random places."""

from typing import Any

import gymnasium as gym

from parking_exp.tasks.parking.highway_lot import obstacles_of_scene
from parking_exp.tasks.reset_rng import reset_rng


class RandomObstacles(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Put obstacles on the lot of parking-v0 at each reset; see `obstacles_of_scene`.

    Args:
        env: highway-env's parking-v0. `NearbyVehicles` around this wrapper shows them.
        obstacles: their number.
    """

    def __init__(self, env: gym.Env, obstacles: int) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, obstacles=obstacles)
        gym.Wrapper.__init__(self, env)
        self.obstacles = obstacles

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        from highway_env.vehicle.objects import Obstacle

        rng = reset_rng(self, seed)
        places = obstacles_of_scene(rng.bit_generator, self.obstacles)
        result = self.env.reset(seed=seed, options=options)
        road = self.unwrapped.road
        road.objects += [Obstacle(road, place) for place in places]
        return result

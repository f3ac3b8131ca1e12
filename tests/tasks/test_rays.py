"""Distances along rays: exactly, by Shapely's geometry, in the simulator and on highway-env."""

import gymnasium as gym
import highway_env
import numpy as np
import pytest
import shapely
from gymnasium.utils.env_checker import check_env
from highway_env.vehicle.objects import Obstacle
from support.shapes import polygon

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.tasks.parking.geometry import Rectangles
from parking_exp.tasks.parking.parking_task import ParkingTask
from parking_exp.tasks.parking.rays import Rays, ray_distances
from parking_exp.tasks.registry import TRAINING_ONLY


def rectangles_of(values):
    """Rectangles with these x, y, headings, lengths and widths."""
    return Rectangles(values[..., :2], values[..., 2], values[..., 3:])


def measured(position, heading, polygons, rays, range_m):
    """Distances along rays by Shapely's geometry."""
    angles = heading + np.arange(rays) * 2 * np.pi / rays
    ends = position + range_m * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    lines = shapely.linestrings([[position, end] for end in ends])
    lengths = shapely.distance(
        shapely.Point(position), shapely.intersection(lines, shapely.union_all(polygons))
    )
    return np.where(np.isnan(lengths), range_m, lengths)


def test_distances_are_those_of_shapelys_geometry():
    rng = np.random.default_rng(0)
    n = 300
    position = rng.uniform(-15, 15, (n, 2))
    heading = rng.uniform(-10, 10, n)
    centres = rng.uniform(-15, 15, (n, 6, 2))
    headings = rng.uniform(-10, 10, (n, 6, 1))
    lengths = rng.uniform(0.5, 20, (n, 6, 1))
    widths = rng.uniform(0.5, 4, (n, 6, 1))
    rectangles = np.concatenate([centres, headings, lengths, widths], axis=-1)
    direction = np.array([np.cos(heading), np.sin(heading)])
    scenes = rectangles_of(rectangles)
    seen = ray_distances(position.T, direction, scenes, 16, 8.0)
    assert 0.3 < (seen == 8).mean() < 0.6
    assert (seen == 0).any()
    for row in range(n):
        polygons = [polygon(*rectangle) for rectangle in rectangles[row]]
        expected = measured(position[row], heading[row], polygons, 16, 8.0)
        np.testing.assert_allclose(seen[row], expected, rtol=0, atol=1e-9)


def test_the_wrapper_shows_vehicles_walls_and_obstacles_of_a_users_own_env():
    gym.register_envs(highway_env)
    env = Rays(gym.make("parking-v0", config={"vehicles_count": 10}), rays=24, range_m=25)
    check_env(env, skip_render_check=True)
    assert env.observation_space["observation"].shape == (30,)
    lot = env.unwrapped
    for seed in range(5):
        observation, _ = env.reset(seed=seed)
        assert env.observation_space.contains(observation)
        assert observation["achieved_goal"].shape == observation["desired_goal"].shape == (6,)
        lot.road.objects.append(Obstacle(lot.road, [-4.0, 2.0]))
        lot.vehicle.position = np.array([20.0, 5.0])
        observation = env.observation(lot.observation_type_parking.observe())
        items = [*lot.road.vehicles[1:], *lot.road.objects[1:]]  # but for the car and its goal
        assert len(items) == 15
        polygons = [shapely.Polygon(item.polygon()) for item in items]
        expected = measured(lot.vehicle.position, lot.vehicle.heading, polygons, 24, 25)
        np.testing.assert_allclose(observation["observation"][6:] * 25, expected, rtol=0, atol=1e-9)
    again = gym.make(env.spec)
    np.testing.assert_array_equal(
        again.reset(seed=5)[0]["observation"], env.reset(seed=5)[0]["observation"]
    )


def test_without_rays_a_config_is_stored_as_it_was_before_there_were_any():
    observation = compose("env.observation.rays=0").plain()["env"]["observation"]
    assert {*observation} == {"type", "features", "scales", "normalize", "vehicles_count"}


def test_rays_are_stored_and_part_of_a_runs_key():
    configs = [
        compose(),
        compose("env.observation.rays=8"),
        compose("env.observation.rays=8", "env.observation.rays_range_m=20"),
    ]
    assert len({config.run_key for config in configs}) == 3
    observation = configs[2].plain()["env"]["observation"]
    assert (observation["rays"], observation["rays_range_m"]) == (8, 20)
    assert {"env.observation.rays", "env.observation.rays_range_m"} <= TRAINING_ONLY
    kwargs = [ParkingTask(config.env).features("ego_mirrored")[1] for config in configs]
    assert kwargs[0]["rays"] == 0
    assert kwargs[1] == kwargs[0] | {"rays": 8}


@pytest.mark.parametrize("override", ["rays=-1", "rays=361", "rays_range_m=0", "rays_range_m=1001"])
def test_a_wrong_number_or_range_is_refused(override):
    with pytest.raises(ConfigError, match=f"^env.observation.{override}"):
        compose(f"env.observation.{override}")

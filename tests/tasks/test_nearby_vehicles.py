"""Other vehicles in the observation and their number: in the simulator, on highway-env, in the
features.
"""

from types import SimpleNamespace

import gymnasium as gym
import highway_env
import numpy as np
import pandas as pd
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from parking_exp.config.compose import compose
from parking_exp.tasks.parking.features import (
    EgoFrameExtractor,
    FineEgoFrameExtractor,
)
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.parking.highway_lot import HighwayLot, sample_places
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.lot_figures import draw_vehicle_rates
from parking_exp.tasks.parking.nearby_vehicles import NearbyVehicles, nearest_vehicles
from parking_exp.tasks.parking.parking_report import cell_data
from parking_exp.tasks.parking.scenes import NO_SLOT

WEIGHTS = [1, 0.3, 0, 0, 0.02, 0.02]


def env_config(vehicles, seen, *overrides):
    options = [
        f"env.vehicles_count={vehicles}",
        f"env.observation.vehicles_count={seen}",
        *overrides,
    ]
    return compose(*options).env


def test_obstacles_are_random_places_in_the_aisle_by_the_documented_rule():
    lot = HighwayLot((0, 0), n_obstacles=4)
    scenes = lot.from_seeds(range(50))
    for seed, places in enumerate(scenes.obstacles):
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)).jumped(2))
        np.testing.assert_array_equal(places, sample_places(rng, 4))
    drawn = lot.random(np.random.default_rng(0), 5_000).obstacles.reshape(-1, 2)
    for places in (scenes.obstacles.reshape(-1, 2), drawn):
        assert (np.linalg.norm(places, axis=1) > 6).all()
        assert (np.abs(places) <= [33, 8.5]).all()
    assert np.abs(drawn.mean(axis=0)).max() < 0.5


def test_the_nearest_come_first_and_absent_ones_are_zero():
    others = np.array([[[30.0, 0.0], [1.0, -2.0], [2e6, 0.0]]])
    seen = nearest_vehicles(
        np.array([[1.0, 0.0]]), others, np.array([[0.0, np.pi / 2, 0.0]]), 4
    ).reshape(4, 5)
    expected = [[1, 0, -0.02, 0, 1], [1, 0.29, 0, 1, 0], [0] * 5, [0] * 5]
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-15)


def test_the_wrapper_goes_around_a_users_own_env():
    gym.register_envs(highway_env)
    env = NearbyVehicles(gym.make("parking-v0", config={"vehicles_count": 3}), vehicles_count=2)
    check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=5)
    assert env.observation_space["observation"].shape == (16,)
    assert env.observation_space.contains(observation)
    car, *others = env.unwrapped.road.vehicles
    nearest = min(others, key=lambda vehicle: np.linalg.norm(vehicle.position - car.position))
    presence, x, y, cos, sin = observation["observation"][6:11]
    np.testing.assert_allclose([x, y], (nearest.position - car.position) / 100, rtol=0, atol=1e-12)
    np.testing.assert_allclose([presence, cos, sin], [1, *nearest.direction], rtol=0, atol=1e-12)
    assert observation["achieved_goal"].shape == observation["desired_goal"].shape == (6,)
    again = gym.make(env.spec)
    np.testing.assert_array_equal(again.reset(seed=5)[0]["observation"], observation["observation"])


def test_a_scenes_number_of_vehicles_follows_the_documented_rule():
    config = env_config("[3,9]", 0)
    env, scenes = make_parking_env(config), lot_of(config).from_seeds(range(40))
    numbers = (scenes.vehicles != NO_SLOT).sum(axis=1)
    for seed, number in enumerate(numbers):
        generator = np.random.PCG64(np.random.SeedSequence(seed))
        assert number == np.random.Generator(generator.jumped()).integers(3, 10)
        if seed < 5:
            env.reset(seed=seed)
            assert len(env.unwrapped.road.vehicles) == 1 + number
    assert {*numbers} == {*range(3, 10)}
    # The other draws of a scene are those of a fixed number.
    fixed = lot_of(env_config(0, 0)).from_seeds(range(40))
    np.testing.assert_array_equal(scenes.goal, fixed.goal)


def test_random_scenes_have_all_numbers_equally_often():
    lot = HighwayLot((0, 20), n_obstacles=0)
    scenes = lot.random(np.random.default_rng(0), 21_000)
    counts = np.bincount((scenes.vehicles != NO_SLOT).sum(axis=1), minlength=21)
    assert (np.abs(counts - 1000) < 5 * np.sqrt(1000)).all()


def scene():
    """A car, a goal and two of three vehicles."""

    def entry(x, y, heading):
        return [x / 100, y / 100, np.cos(heading), np.sin(heading)]

    x, y, cos_h, sin_h = entry(3.0, 2.0, 0.4)
    goal_x, goal_y, goal_cos, goal_sin = entry(10.0, 14.0, np.pi / 2)
    observation = [x, y, 0.2 * cos_h, 0.2 * sin_h, cos_h, sin_h]
    for vehicle in ((14.0, 14.0, np.pi / 2), (6.0, 14.0, np.pi / 2)):
        other_x, other_y, *direction = entry(*vehicle)
        observation += [1.0, other_x - x, other_y - y, *direction]
    return {
        "observation": torch.tensor([observation + 5 * [0.0]], dtype=torch.float32),
        "desired_goal": torch.tensor(
            [[goal_x, goal_y, 0, 0, goal_cos, goal_sin]], dtype=torch.float32
        ),
    }


def extractor(kind):
    weights = [] if kind is EgoFrameExtractor else [WEIGHTS]
    return kind(make_parking_env(env_config(2, 3)).observation_space, *weights)


def test_vehicles_in_the_cars_frame_exactly():
    features = extractor(EgoFrameExtractor)(scene())[0].tolist()
    cos, sin = np.cos(0.4), np.sin(0.4)
    expected = []
    for dx, dy in ((1.1, 1.2), (0.3, 1.2)):
        expected += [1, cos * dx + sin * dy, cos * dy - sin * dx, sin, cos]
    assert features[10:20] == pytest.approx(expected, abs=1e-5)
    assert features[20:] == [0] * 5


def test_vehicles_as_the_goal_sees_them():
    """Its neighbours: 4 m to the right of the slot, and 4 m to its left."""
    features = extractor(FineEgoFrameExtractor)(scene())[0, 19:].reshape(3, 9)
    np.testing.assert_allclose(features[:2, 7:], [[0, -np.tanh(1)], [0, np.tanh(1)]], atol=1e-5)
    assert features[2].tolist() == [0] * 9


def test_rates_by_number_of_vehicles_and_their_figure():
    scenes = HighwayLot((0, 2), n_obstacles=0).from_seeds(range(40))
    numbers = (scenes.vehicles != NO_SLOT).sum(axis=1)
    outcomes = np.array(["success", "crash", "timeout"])[numbers]
    runs = [
        pd.DataFrame({"scene": rows, "outcome": outcomes[rows]})
        for rows in (np.arange(25), np.arange(10, 40))
    ]
    by_vehicles = cell_data(runs, {"env.vehicles_count": "[0, 2]"})["vehicles"]
    seen = np.concatenate([numbers[:25], numbers[10:]])
    assert by_vehicles == [
        {
            "vehicles": k,
            "n": (seen == k).sum(),
            "success": k == 0,
            "crash": k == 1,
            "timeout": k == 2,
        }
        for k in range(3)
    ]
    assert "vehicles" not in cell_data(runs, {"env.vehicles_count": 10})
    assert cell_data([], {"env.vehicles_count": "[0, 2]"}) == {}
    cells = [
        SimpleNamespace(id="c0", label="sac", task_data={"vehicles": by_vehicles}),
        SimpleNamespace(task_data={}),
    ]
    ((figure, _),) = draw_vehicle_rates(SimpleNamespace(shown_cells=cells))
    success, crash = figure.axes
    assert success.lines[0].get_xydata().tolist() == [[0, 100], [1, 0], [2, 0]]
    assert crash.lines[0].get_xydata().tolist() == [[0, 0], [1, 100], [2, 0]]
    assert figure.legends[0].get_texts()[0].get_text() == "sac"

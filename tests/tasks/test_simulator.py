"""The simulator is highway-env: the same scenes and actions give the same trajectory."""

import itertools

import numpy as np
import pytest
from highway_env.utils import are_polygons_intersecting
from hypothesis import given, settings
from hypothesis import strategies as st
from support.marks import slow_but
from support.runs import parking_envs
from support.simulator_equality import KINDS, actions_of, compare, different_scenes, find_mismatches

from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.config.compose import compose
from parking_exp.evaluation.agents import load_model
from parking_exp.tasks.parking.geometry import corners
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.parking.highway_lot import HighwayLot, start_slot
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.parking.simulator.collisions import separating_axis
from parking_exp.tasks.parking.vec_env import ParkingVecEnv

# Every scalar option of the env group that the physics, the observation or the reward depends on.
VARIANTS = {
    "many parked cars, pushed about": [
        "env=parking_action_repeat",
        "env.vehicles_count=26",
        "env.action.acceleration_range=[-12,12]",
    ],
    "no walls": ["env.add_walls=false", "env.duration=10"],
    "speed limits": ["env.action.speed_range=[-2,3]", "env.duration=10"],
    "a lowest speed, no clipping": [
        "env.action.speed_range=[1,6]",
        "env.action.clip=false",
        "env.duration=10",
    ],
    "other ranges": [
        "env.action.acceleration_range=[-3,6]",
        "env.action.steering_range=[-0.3,1]",
        "env.duration=10",
    ],
    "other reward": [
        "env.reward_weights=[1,1,0,0.1,0,0]",
        "env.success_goal_reward=0.3",
        "env.collision_reward=-1",
        "env.duration=10",
    ],
    "other frequencies": [
        "env.simulation_frequency=20",
        "env.policy_frequency=3",
        "env.duration=10",
    ],
    "no effect": ["env.show_trajectories=true", "env.steering_range=0.1", "env.duration=4"],
    "two of four cars": [
        "env.vehicles_count=2",
        "env.observation.vehicles_count=4",
        "env.duration=10",
    ],
    "nearest cars": [
        "env.vehicles_count=[0,20]",
        "env.observation.vehicles_count=8",
        "env.duration=10",
    ],
    "obstacles": [
        "env.obstacles=12",
        "env.observation.vehicles_count=5",
        "env.policy_frequency=1",
        "env.duration=12",
    ],
    "obstacles among many cars": [
        "env.vehicles_count=[0,26]",
        "env.obstacles=12",
        "env.observation.vehicles_count=5",
        "env.policy_frequency=1",
        "env.duration=12",
    ],
    "rays to cars and obstacles": [
        "env.vehicles_count=[0,20]",
        "env.obstacles=8",
        "env.observation.rays=16",
        "env.duration=10",
    ],
    "rays of 40 m": [
        "env.vehicles_count=20",
        "env.observation.rays=32",
        "env.observation.rays_range_m=40",
        "env.duration=10",
    ],
    "one ray, and cars": [
        "env.vehicles_count=5",
        "env.observation.rays=1",
        "env.observation.vehicles_count=4",
        "env.duration=10",
    ],
    "rays to obstacles without walls": [
        "env.obstacles=20",
        "env.observation.rays=7",
        "env.add_walls=false",
        "env.duration=10",
    ],
    "rays in a dead end": [
        "env=parking_dead_end",
        "env.observation.rays=16",
        "env.duration=10",
    ],
}
FAST = ("speed limits", "nearest cars", "obstacles", "rays to cars and obstacles")


def env_config(*overrides) -> ParkingConfig:
    # Noise has an entry for each action, of which some configs have one.
    return compose(
        *overrides, "algorithm.learning_starts=100000", "algorithm.action_noise=null"
    ).env


@pytest.mark.parametrize(
    "kind", slow_but(["biased"], [kind for kind in KINDS if kind != "trained"])
)
@pytest.mark.parametrize("option", slow_but(["parking", "parking_action_repeat"], parking_envs()))
def test_trajectories_are_highway_envs(option, kind):
    config = env_config(f"env={option}", *([] if "repeat" in option else ["env.duration=10"]))
    assert find_mismatches(config, kind, 6) == []


@pytest.mark.slow
@pytest.mark.parametrize("option", parking_envs())
def test_200_000_steps_of_parking_and_20_000_of_variants_without_one_mismatch(option):
    policy = GreedyPolicy(load_model("pretrained/parked"))
    config, steps = env_config(f"env={option}"), 0
    for block, kind in enumerate(itertools.cycle(KINDS)):
        if steps >= (200_000 if option == "parking" else 20_000):
            break
        act = actions_of(kind, np.random.default_rng(block), (25, 2), policy)
        further, mismatches = compare(config, range(25 * block, 25 * block + 25), act)
        assert mismatches == []
        steps += further


@pytest.mark.parametrize("name", slow_but([*FAST, "rays in a dead end"], VARIANTS))
def test_every_option_is_simulated(name):
    config = env_config(*VARIANTS[name])
    for kind in ("biased", "random"):
        assert find_mismatches(config, kind, 8) == []


@pytest.mark.parametrize("parked", slow_but([10], [0, 10, 26]))
def test_scenes_are_highway_envs_bit_for_bit(parked):
    assert different_scenes(range(200), parked) == []


def test_random_scenes_have_the_distribution_of_highway_envs():
    """Two samples of 20,000: goals and parked slots uniform over what is free, headings uniform."""
    n = 20_000
    lot = HighwayLot((3, 3), n_obstacles=0)
    drawn = lot.random(np.random.default_rng(0), n)
    seeded = lot.from_seeds(range(n))
    for scenes in (drawn, seeded):
        assert abs(scenes.heading.mean() - np.pi) < 5 * (2 * np.pi / np.sqrt(12 * n))
        taken = np.concatenate(
            [start_slot(scenes.heading)[:, None], scenes.goal[:, None], scenes.vehicles], axis=1
        )
        assert all(len(set(row)) == 5 for row in taken.tolist())
    for ours, theirs in zip(
        (drawn.goal, *drawn.vehicles.T), (seeded.goal, *seeded.vehicles.T), strict=True
    ):
        counts, expected = np.bincount(ours, minlength=28), np.bincount(theirs, minlength=28)
        assert (np.abs(counts - expected) < 5 * np.sqrt(2 * expected.mean())).all()


@pytest.mark.parametrize("option", ["parking_crowded", "parking_parallel", "parking_bays"])
def test_scenes_far_from_contact_are_driven_as_frame_by_frame(option):
    """A car that touches something is not missed: driving all frames of all scenes is the same."""
    config = env_config(f"env={option}", "env.action.acceleration_range=[-12,12]")
    rng = np.random.default_rng(0)
    scenes = lot_of(config).random(rng, 300)
    fast = Simulator(config, scenes)
    careful = Simulator(config, scenes)
    careful._find_uncertain = lambda *_: np.ones(300, bool)
    for _ in range(40):
        actions = rng.uniform(-1, 1, (300, 2))
        fast.step(actions)
        careful.step(actions)
        for name, array in fast.get_state().items():
            np.testing.assert_array_equal(array, careful.get_state()[name], err_msg=name)
    assert fast.state.crashed.sum() > 100
    assert fast.state.pushed.any()


@pytest.mark.parametrize("option", ["parking", "parking_sparse"])
def test_reward_of_a_batch_of_goals_is_highway_envs(option):
    config = env_config(f"env={option}")
    achieved, desired = np.random.default_rng(0).normal(size=(2, 100, 6))
    dense = make_parking_env(config).unwrapped.compute_reward(achieved, desired, {})
    expected = (
        np.where(dense > -config.success_goal_reward, 0.0, -1.0)
        if option == "parking_sparse"
        else dense
    )
    for ours in (
        ParkingVecEnv(config, 1),
        *([make_parking_env(config)] if option == "parking_sparse" else []),
    ):
        np.testing.assert_allclose(
            ours.compute_reward(achieved, desired, {}), expected, rtol=0, atol=1e-12
        )


coordinate = st.floats(-6, 6)
angle = st.one_of(st.floats(-7, 7), st.sampled_from([0.0, np.pi / 2, -np.pi / 2]))
length = st.sampled_from([1.0, 2.0, 5.0, 42.0, 70.0])
rectangle = st.tuples(coordinate, coordinate, angle, length, length)


def polygon(x, y, heading, long, wide):
    direction = np.array([[np.cos(heading), np.sin(heading)]])
    return corners(np.array([[x, y]]), direction, np.array([long]), np.array([wide]))[0]


@settings(max_examples=500, deadline=None)
@given(rectangle, rectangle, st.tuples(coordinate, coordinate))
def test_collisions_of_rectangles_are_highway_envs(first, second, displacement):
    a, b = polygon(*first), polygon(*second)
    now, soon, push = separating_axis(np.stack([a, b])[None], np.array([displacement]))
    closed = [np.vstack([points, points[:1]]) for points in (a, b)]
    their_now, their_soon, their_push = are_polygons_intersecting(
        *closed, np.array(displacement), np.zeros(2)
    )
    assert (bool(now[0]), bool(soon[0])) == (their_now, their_soon)
    if their_soon:
        np.testing.assert_array_equal(push[0], their_push)

"""Starts that are reached by driving out of the goal, and the contacts that end the way."""

import numpy as np
import pytest
from shapely import box
from support.shapes import polygon

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.tasks.parking import goal_starts
from parking_exp.tasks.parking.free_space import FreeSpace
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, CAR_WIDTH_M, OBSTACLE_M
from parking_exp.tasks.parking.goal_starts import N_DRAWS, GoalStarts, drive
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.scenes import NO_SLOT
from parking_exp.tasks.parking.simulator.dynamics import advance, slip_angle
from parking_exp.tasks.parking.vec_env import ParkingVecEnv

LOTS = (
    ["env=parking_parallel", "env.level=hard"],
    ["env=parking_bays", "env.level=normal"],
    ["env=parking_lots", "env.level=normal"],
    ["env=parking_crowded", "env.obstacles=3"],
)


def touches(scenes, poses, **arguments):
    return FreeSpace(scenes, **arguments).touches(poses)


def shapes_of(scenes, row):
    """What stands in a scene, and the space between its walls."""
    parked = [
        polygon(*pose, CAR_LENGTH_M, CAR_WIDTH_M)
        for pose, slot in zip(scenes.vehicle_pose[row], scenes.vehicles[row], strict=True)
        if slot != NO_SLOT
    ]
    obstacles = [polygon(*place, 0.0, OBSTACLE_M, OBSTACLE_M) for place in scenes.obstacles[row]]
    half_x, half_y = scenes.free[:, row]
    return parked + obstacles, box(-half_x, -half_y, half_x, half_y)


@pytest.mark.parametrize("overrides", LOTS)
def test_contacts_are_those_of_the_shapes(overrides):
    scenes = lot_of(compose(*overrides).env).from_seeds(range(20))
    rng = np.random.default_rng(0)
    around_goals = scenes.goal_pose[:, None] + rng.normal(0, [3, 3, 1], (20, 50, 3))
    touching = touches(scenes, around_goals, walls=True)
    assert 0.2 < touching.mean() < 0.9
    for row in range(20):
        others, inside = shapes_of(scenes, row)
        for pose, expected in zip(around_goals[row], touching[row], strict=True):
            car = polygon(*pose, CAR_LENGTH_M, CAR_WIDTH_M)
            hit = any(car.intersects(other) for other in others) or not inside.contains(car)
            assert hit == expected


def test_a_margin_is_kept_on_all_sides():
    env = compose("env=parking_parallel", "env.lot.slot_length_m=7").env
    scenes = lot_of(env).from_seeds([0])
    at_goal = scenes.goal_pose[:, None]  # 2 m from the cars before and behind, 1 m from the wall
    assert not touches(scenes, at_goal, walls=False, margin_m=1.99).any()
    assert touches(scenes, at_goal, walls=False, margin_m=2.01).all()
    assert not touches(scenes, at_goal, walls=True, margin_m=0.99).any()
    assert touches(scenes, at_goal, walls=True, margin_m=1.01).all()


@pytest.mark.parametrize("steering", [-0.7, 0.0, 0.3])
def test_an_arc_is_what_the_car_drives(steering):
    pose = np.array([1.0, -2.0, 0.5])
    slip = slip_angle(np.array([steering]))
    position, heading, speed = pose[:2, None], pose[2:], np.array([-2.0])
    for _ in range(3000):
        position, heading, speed = advance(
            position, heading, speed, np.zeros(1), slip, np.sin(slip), 0.001
        )
    end = drive(pose, slip[0], np.array(-6.0))
    assert end == pytest.approx([*position[:, 0], heading[0]], abs=2e-3)


@pytest.mark.parametrize("overrides", LOTS)
def test_half_of_the_scenes_start_on_a_free_way_out_of_the_goal(overrides):
    env = compose(*overrides, "env.starts=mixed").env
    starts = GoalStarts(env)
    scenes = starts.from_seeds(range(200))
    usual = lot_of(env).from_seeds(range(200))
    draws = np.empty((200, N_DRAWS))
    for seed in range(200):
        bit_generator = np.random.PCG64(np.random.SeedSequence(seed)).jumped(3)
        draws[seed] = np.random.Generator(bit_generator).random(N_DRAWS)
    moved = draws[:, 0] < 0.5
    assert 80 < moved.sum() < 120
    assert ((scenes.start != usual.start).any(axis=1) == moved).all()
    assert np.array_equal(scenes.goal, usual.goal)
    assert not touches(scenes, scenes.start[:, None], walls=True)[moved].any()

    distance = np.hypot(*(scenes.start - scenes.goal_pose)[moved, :2].T)
    assert distance.max() > 5  # some have left the slot


@pytest.mark.parametrize("lot", ["parking_angled", "parking_parallel"])
def test_nothing_is_touched_between_the_points_of_an_arc(lot, monkeypatch):
    """Each arc that is driven is looked at again at 801 points."""
    env = compose(f"env={lot}", "env.level=normal", "env.starts=goal").env
    arcs = []

    def recorded(pose, slip, driven):
        path = drive(pose, slip, driven)
        arcs.append((pose, slip, driven, path))
        return path

    monkeypatch.setattr(goal_starts, "drive", recorded)
    scenes = GoalStarts(env).from_seeds(range(100))
    rows = np.arange(100)
    starts = [pose[:, 0] for pose, _, _, _ in arcs] + [scenes.start]
    for (pose, slip, driven, path), end in zip(arcs, starts[1:], strict=True):
        last = (path == end[:, None]).all(axis=2).argmax(axis=1)
        length = driven[rows, last]
        fine = drive(pose, slip, length[:, None] * np.linspace(0, 1, 801))
        assert not touches(scenes, fine, walls=True).any()


def test_the_first_arc_is_the_one_that_is_drawn():
    """One arc: in reverse, straight on, a quarter of 8 m, out of an empty bay."""
    env = compose("env=parking", "env.starts=goal").env
    usual = lot_of(env).from_seeds([0])
    draws = np.zeros((1, N_DRAWS))
    draws[0, 3:5] = 0.5, 0.25
    moved = GoalStarts(env).with_starts(usual, draws)
    x, y, heading = usual.goal_pose[0]
    expected = [x - 2 * np.cos(heading), y - 2 * np.sin(heading), heading]
    assert moved.start[0] == pytest.approx(expected)


def test_training_starts_there_and_an_evaluation_does_not():
    env = compose("env=parking_parallel", "env.starts=goal").env
    envs = ParkingVecEnv(env, 8)
    envs.seed(5)
    envs.reset()
    expected = GoalStarts(env).from_seeds(range(5, 13)).start
    assert np.array_equal(envs.batch.state.position.T, expected[:, :2])
    usual = compose("env=parking_parallel").env
    assert np.array_equal(lot_of(env).from_seeds([0]).start, lot_of(usual).from_seeds([0]).start)


def test_starts_out_of_the_goal_need_the_vectorized_simulator():
    with pytest.raises(ConfigError, match=r"env\.starts=goal needs env\.simulator=vectorized"):
        compose("env.starts=goal", "env.simulator=highway_env")


@pytest.mark.parametrize("name", ["speed_range", "acceleration_range"])
def test_starts_out_of_the_goal_need_both_directions(name):
    message = rf"^env\.starts=mixed: env\.action\.{name} has to allow both directions, as the way"
    with pytest.raises(ConfigError, match=message):
        compose("env=parking_parallel", "env.starts=mixed", f"env.action.{name}=[0,5]")
    compose("env=parking_parallel", "env.starts=mixed", "env.action.speed_range=[-1,5]")

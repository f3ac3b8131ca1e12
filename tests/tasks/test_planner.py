"""The planner: its paths, and how the car follows them, in the simulator and in highway-env."""

import importlib.util
from typing import get_args

import numpy as np
import pytest
import shapely
from support.runs import config_refusal
from support.shapes import polygon

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.evaluation.evaluate_policy import evaluate_policy, find_differences
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.planning import Planner
from parking_exp.tasks.parking.planning.planner import OmplPlanner
from parking_exp.tasks.parking.planning.trajectory import REFERENCE, Pace, make_trajectory
from parking_exp.tasks.parking.scene_shapes import scene_shapes
from parking_exp.tasks.registry import make_task

TIGHT = ("env=parking_parallel", "env.level=extreme")
LOTS = ("parking_parallel", "parking_bays", "parking_angled", "parking_dead_end", "parking_lots")


def make_planner(*overrides, seed=0, **arguments):
    return Planner(make_task(compose(*overrides).env), seed, **arguments)


def cars(path):
    """The car at each pose of its rear axle."""
    for x, y, heading in path:
        centre = x + 2.5 * np.cos(heading), y + 2.5 * np.sin(heading)
        yield polygon(*centre, heading, 5, 2)


@pytest.mark.parametrize("env", LOTS)
def test_a_path_leads_from_the_start_to_the_goal_and_touches_nothing(env):
    planner = make_planner(f"env={env}", "env.level=hard")
    scenes = lot_of(planner.task.config).from_seeds([7])
    path = planner.find_path(7)
    for pose, (x, y, heading) in ((path[0], scenes.start[0]), (path[-1], scenes.goal_pose[0])):
        rear = x - 2.5 * np.cos(heading), y - 2.5 * np.sin(heading)
        assert pose[:2] == pytest.approx(rear, abs=1e-9)
        assert np.cos(pose[2] - heading) == pytest.approx(1, abs=1e-9)
    shapes = scene_shapes(scenes, 0, walls=True)
    others = [*shapes["parked_cars"], *shapes["walls"]]
    lot = shapely.union_all([polygon(*other) for other in others])
    assert min(car.distance(lot) for car in cars(path)) > 0


def test_a_path_keeps_to_the_radius_that_the_car_can_drive():
    path = make_planner(*TIGHT).find_path(0)
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    turns = np.abs(np.diff(path[:, 2]))
    # Where the direction changes, the way between two poses is shorter than the path.
    on_curves = turns < 0.02 / 5
    assert np.count_nonzero(~on_curves) == 0
    assert steps.max() <= 0.02


def test_the_path_of_a_scene_depends_on_the_seeds_of_run_and_scene_alone():
    planner = make_planner(*TIGHT)
    planner.find_path(2)
    path = planner.find_path(0)
    np.testing.assert_array_equal(path, make_planner(*TIGHT).find_path(0))
    assert not np.array_equal(path, make_planner(*TIGHT, seed=1).find_path(0))


@pytest.mark.parametrize(
    ("env", "level"), [("parking_parallel", "normal"), ("parking_bays", "extreme")]
)
def test_the_car_parks_in_the_simulator_and_in_highway_env(env, level):
    planner = make_planner(f"env={env}", f"env.level={level}")
    scenes = range(6)
    episodes = evaluate_policy(planner, planner.task, scenes, simulator="vectorized")
    assert episodes["outcome"].tolist() == ["success"] * 6
    assert episodes["parked"].all()
    assert (episodes["plan_s"] > 0).all()
    certified = evaluate_policy(planner, planner.task, scenes, simulator="highway_env")
    assert find_differences(episodes, certified) == []


@pytest.mark.parametrize(
    "overrides",
    [
        ("env=parking_crowded", "env.obstacles=3"),
        (*TIGHT, "algorithm=planner", "env.action.acceleration_range=[-1,1]"),
        (*TIGHT, "algorithm=planner", "env.action.speed_range=[-1,1]"),
    ],
)
def test_a_car_parks_among_obstacles_and_a_slower_one_in_a_tight_slot(overrides):
    planner = make_planner(*overrides)
    assert evaluate_policy(planner, planner.task, range(6))["outcome"].tolist() == ["success"] * 6


def test_a_scene_in_which_ompl_would_repeat_a_step_forever_is_solved():
    assert len(make_planner("env=parking").find_path(0)) > 1


@pytest.mark.parametrize("name", get_args(OmplPlanner))
def test_each_planner_finds_a_path_to_a_slot_that_no_curve_leads_to(name):
    planner = make_planner("env=parking_parallel", planner=name, time_limit_s=60)
    assert len(planner.find_path(1)) > 1


def test_without_a_path_the_car_stands_until_the_time_is_over():
    planner = make_planner(*TIGHT, "env.duration=2", time_limit_s=1e-9)
    assert len(planner.find_path(0)) == 1
    (row,) = evaluate_policy(planner, planner.task, [0]).to_dict("records")
    assert row["outcome"] == "timeout"
    assert row["steps"] == 11
    assert row["speed_mps"] == pytest.approx(0, abs=1e-9)


def test_a_trajectory_stops_where_the_direction_changes_and_at_the_end():
    x = np.concatenate([np.linspace(0, 4, 201), np.linspace(3.98, 1, 150)])
    path = np.stack([x, np.zeros_like(x), np.zeros_like(x)], axis=1)
    rows = make_trajectory(path, Pace(step_s=0.2, speed_mps=2.5, acceleration_mps2=3))
    columns = dict(zip(REFERENCE, rows.T, strict=True))
    standing = columns["speed"] == 0
    assert columns["x"][standing].tolist() == pytest.approx([0, 4, 1])
    assert np.abs(columns["speed"]).max() <= 2.5
    assert np.abs(np.diff(columns["speed"])).max() <= 3 * 0.2 + 1e-9
    # The mean of two speeds, for 0.2 s.
    driven = (columns["speed"] + columns["next_speed"])[:-1] / 2 * 0.2
    np.testing.assert_allclose(np.diff(columns["x"]), driven, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["algorithm=planner", "algorithm.planner=Astar"],
            "algorithm.planner='Astar': input should be 'RRTConnect', 'RRT', 'RRTstar', "
            "'InformedRRTstar', 'BITstar', 'FMT' or 'BFMT'",
        ),
        (
            ["algorithm=planner", "algorithm.margin_m=-1"],
            "algorithm.margin_m=-1: input should be greater than or equal to 0",
        ),
        (
            ["algorithm=planner", "++algorithm.margin=1"],
            "algorithm.margin: there is no such key; did you mean 'margin_m'?",
        ),
        (
            ["algorithm=sac", "algorithm.net_arch=null"],
            "algorithm._target_=parking_exp.algorithms.SAC is not a subclass of "
            "parking_exp.tasks.scripted_policy.ScriptedPolicy",
        ),
        (
            ["algorithm=planner", "env.action.steering_range=[0.1,0.5]"],
            "the planner needs an env.action.steering_range of both directions",
        ),
    ],
)
def test_mistakes_are_refused_with_a_sentence(overrides, message):
    assert config_refusal(*overrides) == message


def test_another_task_is_refused_with_a_sentence():
    env = compose("env=fetch_reach").env
    assert list(Planner.problems(env)) == [
        "the planner drives in parking tasks only; env=fetch_reach is another task"
    ]


def test_without_ompl_the_message_names_the_extra(monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        "parking_exp.tasks.parking.planning.planner.find_spec",
        lambda name: None if name == "ompl" else find_spec(name),
    )
    with pytest.raises(ConfigError, match=r"^the planner needs ompl; pip install 'parking-exp\[pl"):
        compose("algorithm=planner")

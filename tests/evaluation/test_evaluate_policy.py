"""Policy and scenes in, a table of episodes out."""

import math

import numpy as np
import pandas as pd
import pytest
from support.user_policies import FunctionPolicy, constant

from parking_exp import load_model
from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.config.compose import compose
from parking_exp.evaluation.evaluate_policy import (
    describe_episodes,
    evaluate_policy,
    find_differences,
    rank_evaluation,
    summarise,
)
from parking_exp.tasks.metrics import episode_columns, outcome
from parking_exp.tasks.parking.driven_path import reeds_shepp_m
from parking_exp.tasks.parking.geometry import SLOT_LENGTH_M, SLOT_WIDTH_M
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.parking.parking_metrics import METRICS
from parking_exp.tasks.parking.parking_task import ParkingTask
from parking_exp.tasks.parking.pose import is_parked, pose_in_slot
from parking_exp.tasks.registry import make_task


def test_one_row_per_scene_in_the_order_asked_for():
    env = compose("env.duration=2").env
    scenes = [5, 3, 40, 0, *range(100, 140)]  # more than run side by side
    table = evaluate_policy(constant(0.0, 0.0), make_task(env), scenes)
    assert list(table.columns) == episode_columns(METRICS)
    assert table["scene"].tolist() == scenes
    assert set(table["outcome"]) == {"timeout"}
    assert set(table["steps"]) == {11}


def test_rows_are_what_a_plain_loop_sees():
    env_config = compose("env.duration=6").env
    env = make_parking_env(env_config)
    env.reset(seed=1)
    total = 0.0
    steps = 0
    done = False
    while not done:
        _, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
        total += reward
        steps += 1
        done = terminated or truncated
    straight_on = constant(1.0, 0.0)
    (row,) = evaluate_policy(straight_on, make_task(env_config), [1]).to_dict("records")
    assert (row["steps"], row["return"], row["outcome"]) == (
        steps,
        total,
        outcome("crash", info["crashed"], info["is_success"]),
    )
    assert row["distance_m"] == pytest.approx(
        np.linalg.norm(env.unwrapped.vehicle.position - env.unwrapped.vehicle.goal.position)
    )


@pytest.mark.parametrize("simulator", ["vectorized", "highway_env"])
def test_the_driven_path_and_changes_of_gear_are_measured(simulator):
    """Five steps with full acceleration and ten with full brakes, straight on.

    From a speed of v m/s, a step of 0.2 s with +5 m/s2 leads v / 5 + 1 / 15 m further.
    """
    actions = iter([1.0] * 5 + [-1.0] * 10)

    @FunctionPolicy
    def ahead_and_back(observation):
        return np.tile([next(actions), 0.0], (len(observation["observation"]), 1))

    task = make_task(compose("env.duration=2.9").env)
    (row,) = evaluate_policy(ahead_and_back, task, [1], simulator=simulator).to_dict("records")
    task.close()
    assert row["steps"] == 15
    ahead = sum(speed / 5 + 1 / 15 for speed in range(5))
    braking = sum(speed / 5 - 1 / 15 for speed in range(1, 6))
    back = ahead
    assert row["path_m"] == pytest.approx(ahead + braking + back)
    assert row["gear_changes"] == 1
    assert math.isnan(row["park_s"])
    assert math.isnan(row["path_efficiency"])


def test_a_trained_agent_drives_further_than_the_shortest_path():
    policy = GreedyPolicy(load_model("pretrained/parked"))
    env = compose("env=parking_stop").env
    table = evaluate_policy(policy, make_task(env), range(20))
    assert (table["outcome"] == "success").all()
    assert table["park_s"].tolist() == pytest.approx((table["steps"] / 5).tolist())
    assert table["path_efficiency"].between(0.3, 1.001).all()


@pytest.mark.parametrize(
    ("end", "length_m"),
    [
        ((12.0, 0.0, 0.0), 12.0),
        ((-12.0, 0.0, 0.0), 12.0),
        ((0.0, 10.0, math.pi), 5 * math.pi),  # a half circle
        ((5.0, 5.0, math.pi / 2), 5 * math.pi / 2),
        ((0.0, 0.0, math.pi), 5 * math.pi),  # three turns of 60 degrees
    ],
)
def test_the_shortest_path_has_turns_of_the_smallest_radius(end, length_m):
    assert reeds_shepp_m((0.0, 0.0, 0.0), end, 5.0) == pytest.approx(length_m)


@pytest.mark.parametrize(
    ("pose", "parked"),
    [
        ((0, 0, 0, 0), True),
        ((1.5, 0, 0, 0), True),  # the front bumper on the line: 1.5 + 5 / 2 = 4
        ((1.51, 0, 0, 0), False),
        ((0, 1.0, 0, 0), True),  # the side on the line: 1 + 2 / 2 = 2
        ((0, -1.01, 0, 0), False),
        ((0, 0, math.radians(9.9), 0), True),
        ((0, 0, math.radians(-10.1), 0), False),
        ((0, 0.7, math.radians(9.9), 0), False),  # turned, a corner is over the line
        ((0, 0, 0, 0.49), True),
        ((0, 0, 0, -0.5), False),
    ],
)
def test_parked_is_inside_the_lines_straight_and_stationary(pose, parked):
    assert is_parked(*pose, SLOT_LENGTH_M, SLOT_WIDTH_M) == parked


def test_the_pose_is_seen_from_the_slot():
    ahead, left, slot = np.array([0.6, 0.8]), np.array([-0.8, 0.6]), np.array([4.0, 14.0])
    heading = math.atan2(0.8, 0.6)
    place = slot + ahead + 0.25 * left
    turned = heading + 0.1 - 2 * math.pi
    pose = pose_in_slot(place, turned, -2.0, slot, heading, (SLOT_LENGTH_M, SLOT_WIDTH_M))
    assert (pose.ahead_m, pose.side_m, pose.heading_error_rad, pose.speed_mps) == pytest.approx(
        (1.0, 0.25, 0.1, -2.0)
    )
    assert pose.distance_m == pytest.approx(math.hypot(1.0, 0.25))


EPISODES = pd.DataFrame(
    {
        "scene": [0, 1, 2, 3],
        "outcome": ["success", "success", "crash", "timeout"],
        "parked": [True, False, False, False],
        "steps": [10, 20, 30, 500],
        "return": [-1.0, -2.0, -8.0, -100.0],
        "distance_m": [0.5, 1.0, 5.0, 10.0],
        "heading_error_rad": [0.0, 0.2, 0.4, 1.0],
        "speed_mps": [0.0, 1.0, 5.0, 0.0],
        "park_s": [2.0, 4.0, math.nan, math.nan],
        "path_m": [8.0, 12.0, 20.0, 0.0],
        "path_efficiency": [0.5, 0.75, math.nan, math.nan],
        "gear_changes": [1, 0, 0, 3],
        "plan_s": [math.nan, 0.25, math.nan, 0.75],
    }
)


def test_a_table_is_summarised_as_rates_with_intervals_and_means():
    assert summarise(EPISODES, METRICS) == {
        "success_rate": 0.5,
        "crash_rate": 0.25,
        "timeout_rate": 0.25,
        "parked_rate": 0.25,
        "return_mean": -27.75,
        "steps_mean": 140.0,
        "distance_m_mean": 4.125,
        "heading_error_rad_mean": 0.4,
        "speed_mps_mean": 1.5,
        "park_s_mean": 3.0,
        "path_m_mean": 10.0,
        "path_efficiency_mean": 0.625,
        "gear_changes_mean": 1.0,
        "plan_s_mean": 0.5,
    }
    lines = describe_episodes(EPISODES, METRICS)
    assert lines[0] == "success   50.0%   95 % interval 15.0% to 85.0%   2 of 4"
    assert lines[3].startswith("parked    25.0%   95 % interval 4.6% to 69.9%   1 of 4")
    assert "return -27.8, distance at the end 4.12 m" in lines[4]


def test_a_metric_that_no_episode_has_is_left_out():
    failures = EPISODES[EPISODES["outcome"] != "success"]
    summary = summarise(failures, METRICS)
    assert "park_s_mean" not in summary
    assert summary["path_m_mean"] == 10.0
    assert "time to success" not in describe_episodes(failures, METRICS)[-1]


def test_the_best_is_chosen_by_success_then_crashes_then_steps():
    def summary(success, crash, steps):
        return {"success_rate": success, "crash_rate": crash, "steps_mean": steps}

    best_first = [
        summary(0.9, 0.1, 50),
        summary(0.9, 0.1, 60),
        summary(0.9, 0.05, 500),
        summary(0.8, 0.0, 10),
    ]
    order = sorted(
        best_first, key=lambda summary: rank_evaluation(summary, ParkingTask), reverse=True
    )
    assert order == [best_first[2], best_first[0], best_first[1], best_first[3]]


def test_two_simulators_differ_in_what_is_further_apart_than_rounding():
    ours = pd.DataFrame({"scene": [3, 4], "outcome": ["success"] * 2, "speed": [1.0, math.nan]})
    same = ours.assign(speed=[1.0 + 1e-10, math.nan])
    assert find_differences(ours, same) == []

    others = ours.assign(outcome=["crash", "success"], speed=[1.0, 2.0])
    assert find_differences(ours, others) == [
        "scene 3: outcome success and crash",
        "scene 4: speed nan and 2.0",
    ]

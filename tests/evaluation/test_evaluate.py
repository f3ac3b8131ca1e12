"""Policy and scenes in, a table of episodes out."""

import math

import numpy as np
import pandas as pd
import pytest
from support.runs import make_config

from parking_exp.envs.geometry import SLOT_POSITIONS
from parking_exp.envs.highway import make_env
from parking_exp.envs.outcomes import Pose, outcome, relative_pose
from parking_exp.envs.scenes import Scenes
from parking_exp.evaluation.description import describe
from parking_exp.evaluation.evaluate_policy import differences, evaluate, rank, summarise
from parking_exp.evaluation.metrics import EPISODE_COLUMNS
from parking_exp.evaluation.trajectories import Recorder
from parking_exp.results.recordings import read_trajectories
from parking_exp.statistics import wilson_interval


def straight_on(observation):
    return np.tile([1.0, 0.0], (len(observation["observation"]), 1))


def wait(observation):
    return np.zeros((len(observation["observation"]), 2))


def test_one_row_per_scene_in_the_order_asked_for():
    env = make_config("env.duration=2").env
    scenes = [5, 3, 40, 0, *range(100, 140)]  # more than run side by side
    table = evaluate(wait, env, scenes)
    assert list(table.columns) == EPISODE_COLUMNS
    assert table["scene"].tolist() == scenes
    assert set(table["outcome"]) == {"timeout"}
    assert set(table["steps"]) == {11}


def test_an_episode_does_not_depend_on_its_neighbours():
    env = make_config("env.duration=6").env
    together = evaluate(straight_on, env, range(40)).set_index("scene")
    alone = evaluate(straight_on, env, [37]).set_index("scene")
    pd.testing.assert_series_equal(together.loc[37], alone.loc[37])


@pytest.mark.slow
@pytest.mark.parametrize("option", ["parking", "parking_crowded", "parking_sparse"])
def test_both_simulators_give_the_same_table(option):
    env = make_config(f"env={option}", "env.duration=4").env
    ours, theirs = (evaluate(straight_on, env, range(30), simulator=name) for name in ("vectorized", "highway_env"))
    assert "crash" in set(ours["outcome"])
    pd.testing.assert_frame_equal(ours, theirs, check_exact=True)
    assert differences(ours, theirs) == []


@pytest.mark.parametrize("simulator", ["vectorized", "highway_env"])
def test_trajectories_lead_from_the_origin_to_where_the_episode_ended(simulator, tmp_path):
    env = make_config("env.duration=4").env
    recorder = Recorder()
    table = evaluate(straight_on, env, [5, 3, 40], simulator=simulator, recorder=recorder)
    recorder.save(tmp_path / "trajectories.npz")
    rows = read_trajectories((tmp_path / "trajectories.npz").read_bytes())
    assert list(rows.columns) == ["scene", "step", "x_m", "y_m", "heading_rad", "speed_mps"]
    assert rows["scene"].unique().tolist() == [3, 5, 40]
    scenes = Scenes.from_seeds([3, 5, 40])
    for number, (scene, one) in enumerate(rows.groupby("scene")):
        end = table.set_index("scene").loc[scene]
        assert one["step"].tolist() == list(range(end["steps"] + 1))
        assert one.iloc[0][["x_m", "y_m", "speed_mps"]].tolist() == [0, 0, 0]
        assert one.iloc[0]["heading_rad"] == np.float32(scenes.heading[number])
        slot = SLOT_POSITIONS[scenes.goal[number]]
        away = np.hypot(*(one.iloc[-1][["x_m", "y_m"]].to_numpy(float) - slot))
        assert away == pytest.approx(end["distance_m"], abs=1e-5)
        assert abs(one.iloc[-1]["speed_mps"]) == pytest.approx(end["speed_mps"], abs=1e-6)


@pytest.mark.slow
def test_both_simulators_record_the_same_trajectories():
    env = make_config("env=parking_crowded", "env.duration=4").env
    found = {}
    for simulator in ("vectorized", "highway_env"):
        found[simulator] = Recorder()
        evaluate(straight_on, env, range(12), simulator=simulator, recorder=found[simulator])
    ours, theirs = (np.concatenate(recorder._cars) for recorder in found.values())
    np.testing.assert_array_equal(ours, theirs)


def test_a_difference_between_tables_is_named():
    env = make_config("env.duration=2").env
    table = evaluate(wait, env, [3, 8])
    other = table.assign(outcome=["timeout", "success"], distance_m=table["distance_m"] + [5e-10, 2e-9])
    (found,) = differences(table, other)
    assert found.startswith("scene 8: outcome timeout and success, distance_m ")


def test_rows_are_what_a_plain_loop_sees():
    env_config = make_config("env.duration=6").env
    env = make_env(env_config)
    env.reset(seed=1)
    total, steps, done = 0.0, 0, False
    while not done:
        _, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0]))
        total, steps, done = total + reward, steps + 1, terminated or truncated
    (row,) = evaluate(straight_on, env_config, [1]).to_dict("records")
    assert (row["steps"], row["return"], row["outcome"]) == (steps, total, outcome(info["crashed"], info["is_success"]))
    assert row["distance_m"] == pytest.approx(
        np.linalg.norm(env.unwrapped.vehicle.position - env.unwrapped.vehicle.goal.position)
    )


def test_evaluation_can_be_stopped_from_outside():
    class Stopped(Exception):
        pass

    def stop(finished):
        raise Stopped

    with pytest.raises(Stopped):
        evaluate(wait, make_config().env, [0], on_step=stop)


@pytest.mark.parametrize(
    ("crashed", "is_success", "expected"),
    [(False, True, "success"), (True, False, "crash"), (True, True, "crash"), (False, False, "timeout")],
)
def test_every_episode_has_exactly_one_outcome(crashed, is_success, expected):
    assert outcome(crashed, is_success) == expected


@pytest.mark.parametrize(
    ("placed", "parked"),
    [
        (Pose(0, 0, 0, 0), True),
        (Pose(1.5, 0, 0, 0), True),  # the front bumper on the line: 1.5 + 5 / 2 = 4
        (Pose(1.51, 0, 0, 0), False),
        (Pose(0, 1.0, 0, 0), True),  # the side on the line: 1 + 2 / 2 = 2
        (Pose(0, -1.01, 0, 0), False),
        (Pose(0, 0, math.radians(9.9), 0), True),
        (Pose(0, 0, math.radians(-10.1), 0), False),
        (Pose(0, 0, math.pi, 0), False),
        (Pose(0, 0.7, math.radians(9.9), 0), False),  # turned, a corner is over the line
        (Pose(0, 0, 0, 0.49), True),
        (Pose(0, 0, 0, -0.5), False),
    ],
)
def test_parked_is_inside_the_lines_straight_and_standing(placed, parked):
    assert placed.parked is parked


def test_the_pose_is_seen_from_the_slot():
    env = make_env(make_config().env)
    env.reset(seed=0)
    car = env.unwrapped.vehicle
    heading = car.goal.heading
    car.position = (
        car.goal.position
        + 1.0 * np.array([math.cos(heading), math.sin(heading)])
        + 0.25 * np.array([-math.sin(heading), math.cos(heading)])
    )
    car.heading, car.speed = heading + 0.1 - 2 * math.pi, -2.0
    found = relative_pose(car.position, car.heading, car.speed, car.goal.position, car.goal.heading)
    assert (found.ahead_m, found.side_m, found.heading_error_rad, found.speed_mps) == pytest.approx(
        (1.0, 0.25, 0.1, -2.0)
    )
    assert found.distance_m == pytest.approx(math.hypot(1.0, 0.25))


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
    }
)


def test_a_summary_has_rates_and_means():
    assert summarise(EPISODES) == {
        "success_rate": 0.5, "crash_rate": 0.25, "timeout_rate": 0.25, "parked_rate": 0.25, "return_mean": -27.75,
        "steps_mean": 140.0, "distance_m_mean": 4.125, "heading_error_rad_mean": 0.4, "speed_mps_mean": 1.5,
    }  # fmt: skip


def test_a_description_has_intervals():
    lines = describe(EPISODES).splitlines()
    assert lines[0] == "success   50.0%   95 % interval 15.0% to 85.0%   2 of 4"
    assert lines[3].startswith("parked    25.0%   95 % interval 4.6% to 69.9%   1 of 4")


def test_the_best_is_chosen_by_success_then_crashes_then_steps():
    def summary(success, crash, steps):
        return {"success_rate": success, "crash_rate": crash, "steps_mean": steps}

    best_first = [summary(0.9, 0.1, 50), summary(0.9, 0.1, 60), summary(0.9, 0.05, 500), summary(0.8, 0.0, 10)]
    order = sorted(best_first, key=rank, reverse=True)
    assert order == [best_first[2], best_first[0], best_first[1], best_first[3]]


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (95, 100, 0.8882, 0.9785), (50, 100, 0.4038, 0.5962)],
)
def test_wilson_interval(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


def test_a_rate_of_nothing_has_no_interval():
    with pytest.raises(ValueError, match="at least one trial"):
        wilson_interval(0, 0)

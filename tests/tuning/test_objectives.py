"""Objectives of runs, on curves that are written by hand."""

import pytest
from support.runs import make_config

from parking_exp.tuning.objectives import RunCurve, updates_at, values_so_far

CURVE = RunCurve(
    [1000, 2000, 3000, 4000, 5000],
    [0.0, 0.5, 0.96, 0.95, 1.0],
    {"final/success_rate": 0.97, "final/parked_rate": 0.1},
)


def test_updates_follow_from_steps():
    config = make_config("n_envs=8", "updates_per_step=0.25", "algorithm.learning_starts=1000")
    assert [updates_at(config, step) for step in (0, 1000, 1032, 5000)] == [0, 0, 8, 1000]
    by_episodes = make_config(
        "algorithm.train_freq=[1,episode]", "n_envs=1", "updates_per_step=0.25", "algorithm.learning_starts=1000"
    )
    assert updates_at(by_episodes, 1500) == 500


@pytest.mark.parametrize(
    ("objective", "value"),
    [("success_auc", (0.25 + 0.73 + 0.955 + 0.975) / 4), ("final_success", 0.97), ("final_parked", 0.1)],
)
def test_each_objective_of_a_run(objective, value):
    assert CURVE.value(objective) == pytest.approx(value)


def test_pruning_compares_the_mean_area_so_far_weighted_by_what_is_over_of_the_run():
    half = RunCurve([1000, 2000], [0.0, 0.5], {})
    assert values_so_far([], half, 2000) == [0.0, 0.25]
    assert values_so_far([0.75], half, 2000) == [0.75 / 1.5, (0.75 + 0.25) / 2]
    assert values_so_far([0.75], half, 8000) == [0.75 / 1.125, (0.75 + 0.25 / 4) / 1.25]
    assert values_so_far([], RunCurve([0], [0.5], {}), 8000) == [0.5]

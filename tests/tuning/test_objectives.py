"""Objectives of runs, on curves that are written by hand."""

import pytest
from support.runs import make_config

from parking_exp.tuning.objectives import RunCurve, partial_value, run_value, updates_at

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
    assert run_value(objective, CURVE) == pytest.approx(value)


def test_pruning_compares_the_mean_area_so_far():
    half = RunCurve([1000, 2000], [0.0, 0.5], {})
    assert partial_value([0.75], half, share=1.0) == 0.5
    assert partial_value([0.75], half, share=0.25) == 0.65
    assert partial_value([], half, share=0.25) == 0.25

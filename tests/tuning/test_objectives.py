"""Objectives and costs of runs, on curves that are written by hand."""

import pytest
from support.runs import make_config

from parking_exp.tuning.objectives import (
    CENSORED_S,
    RunCurve,
    UnitCosts,
    cost_at,
    describe,
    partial_value,
    run_value,
    updates_at,
)

UNITS = UnitCosts(update_s=0.002, step_s=0.00001)
LEARNS = RunCurve([1000, 2000, 3000, 4000, 5000], [0.0, 0.5, 0.96, 0.95, 1.0], {"final/success_rate": 0.97})
SLIPS = RunCurve([1000, 2000, 3000, 4000, 5000], [0.0, 0.96, 0.96, 0.9, 1.0], {"final/parked_rate": 0.1})


def config(*overrides):
    return make_config("n_envs=8", "updates_per_step=0.25", "algorithm.learning_starts=1000", *overrides)


def test_updates_follow_from_steps():
    assert [updates_at(config(), step) for step in (0, 1000, 1032, 5000)] == [0, 0, 8, 1000]
    by_episodes = config("algorithm.train_freq=[1,episode]", "n_envs=1")
    assert updates_at(by_episodes, 1500) == 500


def test_cost_is_updates_and_steps_in_unit_costs():
    assert cost_at(config(), 5000, UNITS) == pytest.approx(1000 * 0.002 + 5000 * 0.00001)


def test_each_objective_of_a_run_that_learns():
    values = {name: run_value(name, config(), LEARNS, UNITS) for name in ("success_auc", "final_success", "cost_to_95")}
    assert values["success_auc"] == pytest.approx((0.25 + 0.73 + 0.955 + 0.975) / 4)
    assert values["final_success"] == 0.97
    assert values["cost_to_95"] == pytest.approx(cost_at(config(), 3000, UNITS))
    assert run_value("final_parked", config(), SLIPS, UNITS) == 0.1


def test_a_run_that_does_not_hold_95_costs_more_than_any_that_does_and_less_the_better_it_is():
    slips = run_value("cost_to_95", config(), SLIPS, UNITS)
    never = run_value("cost_to_95", config(), RunCurve(SLIPS.steps, [0.0] * 5, {}), UNITS)
    assert CENSORED_S < slips < never
    assert describe("cost_to_95", slips, 1) == "1 of 1 seeds never hold 95 %"
    assert describe("cost_to_95", (slips + 50.0 + 60.0) / 3, 3) == "1 of 3 seeds never hold 95 %"
    assert describe("cost_to_95", 42.25, 3) == "42.2 CPU-s"
    assert describe("success_auc", 0.8125, 3) == "81.2%"


def test_pruning_compares_the_mean_area_so_far_and_for_a_cost_the_lower_the_better():
    half = RunCurve([1000, 2000], [0.0, 0.5], {})
    assert partial_value("success_auc", [0.75], half, share=1.0) == 0.5
    assert partial_value("success_auc", [0.75], half, share=0.25) == 0.65
    assert partial_value("cost_to_95", [0.75], half, share=0.25) == 0.35
    assert partial_value("cost_to_95", [], half, share=0.25) == 0.75

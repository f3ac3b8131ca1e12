"""Objectives of runs, on hand-written curves."""

import json

import pytest
from support.runs import make_config

from parking_exp.runs.directory import RunDirectory, RunResult
from parking_exp.tuning.trial_worker import objective_value, updates_at, values_so_far


def test_updates_follow_from_steps():
    config = make_config("n_envs=8", "updates_per_step=0.25", "algorithm.learning_starts=1000")
    assert [updates_at(config, step) for step in (0, 1000, 1032, 5000)] == [0, 0, 8, 1000]
    by_episodes = make_config(
        "algorithm.train_freq=[1,episode]", "n_envs=1", "updates_per_step=0.25", "algorithm.learning_starts=1000"
    )
    assert updates_at(by_episodes, 1500) == 500


@pytest.mark.parametrize(
    ("objective", "value"),
    [("success_auc", (0.25 + 0.73 + 0.955 + 0.975) / 4), ("final_success", 1.0), ("final_parked", 0.1)],
)
def test_each_objective_of_a_run(tmp_path, objective, value):
    directory = RunDirectory(tmp_path / "seed=0")
    directory.create(make_config(f"output_dir={tmp_path}"))
    rates = {1000: 0.0, 2000: 0.5, 3000: 0.96, 4000: 0.95}
    lines = [{"step": step, "time_ms": 0, "metrics": {"eval/success_rate": rate}} for step, rate in rates.items()]
    (directory.path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    final = {"final/success_rate": 1.0, "final/parked_rate": 0.1}
    directory.finish(RunResult(str(directory.path), None, 5000, final), wall_s=1)
    assert objective_value(directory, objective) == pytest.approx(value)


def test_pruning_compares_mean_areas_with_the_current_run_weighted_by_its_progress():
    half = ([1000, 2000], [0.0, 0.5])
    assert values_so_far([], *half, 2000) == [0.0, 0.25]
    assert values_so_far([0.75], *half, 2000) == [0.75 / 1.5, (0.75 + 0.25) / 2]
    assert values_so_far([0.75], *half, 8000) == [0.75 / 1.125, (0.75 + 0.25 / 4) / 1.25]
    assert values_so_far([], [0], [0.5], 8000) == [0.5]

"""Workers of a search: the objective, and how they handle runs that fail, are killed or pruned."""

import errno
import json
import os
import shutil

import optuna
import pytest
from support.searches import QUICK

from parking_exp.config.compose import compose
from parking_exp.errors import OutputDirectoryError, ResultsError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_state import read_state
from parking_exp.tuning.search import Search, read_search
from parking_exp.tuning.trial_worker import run_trials, success_auc


@pytest.fixture
def search(tmp_path):
    options = ["n_trials=2", "search.tuning_seeds=[1001,1002]", "tracking.mlflow=false"]
    search = Search([*QUICK, *options, f"output_dir={tmp_path}"])
    search.open()
    search.save()
    return search


def training_that_ends_with(calls, **status):
    """A function that trains nothing and writes a status."""

    def train(path):
        calls.append(path)
        RunDirectory(path).update_status(**status)
        return "failed"

    return train


def succeed(path, rate=0.5):
    """Finish a run, with one success rate from beginning to end."""
    RunDirectory(path).finish(60, {"final/success_rate": rate}, wall_s=1)
    return "done"


def trials(search):
    return read_search(search.folder).trials


def test_a_killed_run_is_tried_three_times_and_a_full_disk_leaves_the_trial_open(search):
    calls = []
    full_disk = training_that_ends_with(
        calls, status="failed", error=f"OSError: {os.strerror(errno.ENOSPC)}"
    )
    with pytest.raises(OutputDirectoryError, match=r"trial 0: .*No space left"):
        run_trials(search, full_disk)
    assert (len(calls), trials(search)[0].state) == (3, "pending")
    run_trials(
        search,
        training_that_ends_with(calls, status="failed", error="killed by SIGKILL", killed=True),
    )
    assert len(calls) == 9
    assert [trial.state for trial in trials(search)] == ["failed"] * 2


def test_a_failed_run_fails_its_trial_and_a_stopped_one_leaves_it_open(search):
    run_trials(search, training_that_ends_with([], status="failed", error="broken"))
    for trial in trials(search):
        assert (trial.state, trial.reason) == ("failed", "seed 1001: broken")
    more = Search([*search.overrides, "n_trials=3"])
    run_trials(more, lambda path: "interrupted")
    more.save()
    assert trials(more)[2].state == "pending"
    run_trials(more, succeed)
    last = trials(more)[2]
    assert (last.state, last.by_seed, last.value) == ("done", [0.5, 0.5], 0.5)


def test_a_trial_that_is_worse_than_the_median_is_pruned_after_a_seed_and_trial_0_is_not(search):
    study = search.open().study
    for _ in range(5):
        study.add_trial(optuna.trial.create_trial(value=1.0, intermediate_values={1: 1.0, 2: 1.0}))
    more = Search([*search.overrides, "n_trials=7"])
    more.save()
    for _ in range(2):  # the second time there is nothing to do
        run_trials(more, succeed)
        first, *_, last = trials(more)
        assert (first.state, len(first.runs)) == ("done", 2)
        assert (last.state, len(last.runs)) == ("pruned", 1)
    assert read_state(more.base.output_path / last.runs[0]).stage == "done"


def test_the_objective_is_the_normalised_area_under_the_success_curve(tmp_path):
    directory = RunDirectory(tmp_path / "seed=0")
    directory.write_config(compose(f"output_dir={tmp_path}"))
    rates = {1000: 0.0, 2000: 0.5, 3000: 0.96, 4000: 0.95}
    lines = [
        {"step": step, "time_ms": 0, "metrics": {"eval/success_rate": rate}}
        for step, rate in rates.items()
    ]
    (directory.path / "metrics.jsonl").write_text(
        "".join(json.dumps(line) + "\n" for line in lines)
    )
    directory.finish(5000, {"final/success_rate": 1.0}, wall_s=1)
    assert success_auc(directory) == pytest.approx((0.25 + 0.73 + 0.955 + 0.975) / 4)


def test_results_that_were_deleted_end_the_search_and_deleting_their_run_mends_it(search):
    def stop_at_second_seed(path):
        return "interrupted" if path.name == "seed=1002" else succeed(path)

    run_trials(search, stop_at_second_seed)
    path = search.base.output_path / trials(search)[0].runs[0]
    (path / "result.json").unlink()
    with pytest.raises(ResultsError) as refused:
        run_trials(search, succeed)
    assert str(refused.value) == (
        f"{path}: the finished run has no success rate left; delete the directory to train it again"
    )
    assert trials(search)[0].state == "pending"

    shutil.rmtree(path)
    run_trials(search, succeed)
    assert [trial.by_seed for trial in trials(search)] == [[0.5, 0.5]] * 2

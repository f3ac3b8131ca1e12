"""Workers of a search: how many trials they train, and how they handle runs that fail, are killed or pruned."""

import errno
import os

import optuna
import pytest
from support.searches import QUICK

from parking_exp.errors import OutputDirectoryError
from parking_exp.runs.directory import RunDirectory
from parking_exp.sweeps.supervisor import supervise
from parking_exp.tuning.search import Search, study_in
from parking_exp.tuning.trial_worker import work


@pytest.fixture
def search(tmp_path):
    options = ["n_trials=2", "search.tuning_seeds=[1001,1002]", "tracking.mlflow=false", "search.grace_updates=0"]
    search = Search([*QUICK, *options, f"output_dir={tmp_path}"])
    search.open()
    search.save()
    return search


def training_that_ends_with(calls, **status):
    """A function that trains nothing and writes a status."""

    def train(path, stop):
        calls.append(path)
        RunDirectory(path).update(**status)
        return "failed"

    return train


def trials(search):
    return study_in(search.folder).trials


def test_a_failed_run_fails_its_trial_a_killed_one_is_tried_three_times_and_a_full_disk_leaves_it_open(search):
    full_disk = training_that_ends_with([], status="failed", error=f"OSError: {os.strerror(errno.ENOSPC)}")
    with pytest.raises(OutputDirectoryError, match=r"trial 0: .*No space left"):
        work(search.folder, 1, full_disk)
    assert trials(search)[0].state == "pending"
    work(search.folder, 1, training_that_ends_with([], status="failed", error="broken"))
    failed, other = trials(search)
    assert (failed.state, failed.reason, other.state) == ("failed", "seed 1001: broken", "pending")
    calls = []
    work(search.folder, 2, training_that_ends_with(calls, status="failed", error="killed by SIGKILL", killed=True))
    assert len(calls) == 3
    assert trials(search)[1].state == "failed"


@pytest.mark.slow
def test_a_trial_that_is_worse_than_the_median_is_pruned_and_trial_0_is_not(search):
    study = search.open().study
    for _ in range(5):
        study.add_trial(optuna.trial.create_trial(value=1.0, intermediate_values=dict.fromkeys(range(20), 1.0)))

    for _ in range(2):  # the second time there is nothing to do
        work(search.folder, 2, lambda path, stop: supervise(path, stop=stop))
        assert [trial.state for trial in trials(search)] == ["done", "pruned"]
        assert [len(trial.runs) for trial in trials(search)] == [2, 1]
    assert trials(search)[0].env_steps == 120

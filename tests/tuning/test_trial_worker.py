"""Tests of a search's workers: what they are given, and which trials they train."""

import pytest
from support.searches import QUICK

from parking_exp.runs.directory import RunDirectory
from parking_exp.sweeps import slurm
from parking_exp.sweeps.hydra_launcher import Launch
from parking_exp.tuning import trial_worker as worker
from parking_exp.tuning.search import Search, study_in
from parking_exp.tuning.trials import rows

JOB = ["study='/some where/smoke'", "n_trials=3"]


def test_workers_train_no_more_trials_than_their_job_says(tmp_path):
    search = Search([*QUICK, "n_trials=5", f"output_dir={tmp_path}"])
    search.open()
    search.save()

    def break_it(path, stop):
        RunDirectory(path).update(status="failed", error="broken")
        return "failed"

    worker.work(search.folder, 2, break_it)
    found = study_in(search.folder)
    trials = rows(found.study, search.folder, found.n_trials)
    assert [(trial.state, trial.reason) for trial in trials] == [("failed", "seed 1001: broken")] * 2
    assert found.n_trials == 5


STORED = [*JOB, "storage='postgresql://me@host/studies'"]


def test_a_launcher_of_hydras_hands_folder_storage_and_number_of_trials_to_the_task():
    seen = []
    launch = Launch(
        ["hydra/launcher=basic"], task=lambda job: seen.append((job.study, job.n_trials, job.storage, job.run))
    )
    assert launch.jobs([JOB, STORED]) == ([None, None], None)
    assert seen == [
        ("/some where/smoke", 3, None, None),
        ("/some where/smoke", 3, "postgresql://me@host/studies", None),
    ]


@pytest.mark.parametrize("launcher", ["local", "slurm"])
@pytest.mark.parametrize(("job", "storage"), [(JOB, None), (STORED, "postgresql://me@host/studies")])
def test_our_launchers_hand_folder_storage_and_number_of_trials_to_each_worker(monkeypatch, launcher, job, storage):
    seen = []
    monkeypatch.setattr(
        worker, "work", lambda folder, n_trials, _, storage: seen.append((str(folder), n_trials, storage))
    )
    monkeypatch.setattr(worker, "work_job", lambda folder, n_trials, storage: seen.append((folder, n_trials, storage)))
    monkeypatch.setattr(slurm, "launch", lambda task, paths, *_: [task(str(path)) for path in paths])
    options = ["hydra.launcher.executor=local"] if launcher == "slurm" else []
    launch = Launch([f"hydra/launcher={launcher}", "hydra.launcher.n_jobs=2", *options])
    assert launch.jobs([job, job]) == ([None, None], None)
    assert seen == [("/some where/smoke", 3, storage)] * 2

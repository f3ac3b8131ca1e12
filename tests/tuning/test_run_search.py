"""Whole searches in processes of their own: from the first call to the tuned config, cut off in every way."""

import os
import random
import signal
import time

import pytest
import yaml
from support.runs import run_script, store
from support.searches import QUICK
from support.sweep_processes import FAILING, begin, statuses, wait_until, workers

from parking_exp.runs.atomic_files import read_json
from parking_exp.runs.run_state import read_state
from parking_exp.tuning.search import study_in

TWO = "n_workers=2"
TUNE = {"name": "tune", "options": QUICK}
LONGER = ("total_timesteps=3000", "checkpoint.every_n_steps=200")


def tune(output_dir, *arguments, **keywords):
    return run_script("tune", *QUICK, f"output_dir={output_dir}", *arguments, env=FAILING, timeout=600, **keywords)


def trials(output_dir):
    return study_in(output_dir / "smoke").trials


def states(output_dir):
    return [trial.state for trial in trials(output_dir)]


def test_a_search_of_one_trial_has_runs_with_tags_a_status_and_goes_on_when_typed_again(tmp_path):
    options = ("search.tuning_seeds=[1001]", "tracking.mlflow=true")
    done = tune(tmp_path, "n_trials=1", *options)
    assert done.returncode == 0, done.stderr
    (trial,) = trials(tmp_path)
    assert (trial.state, trial.changes, trial.value, trial.env_steps) == ("done", {}, 0.0, 60)
    (run,) = store(tmp_path).search_runs(["1"])
    assert {name: run.data.tags[name] for name in ("search", "trial", "seed")} == {
        "search": "smoke", "trial": "0", "seed": "1001",
    }  # fmt: skip
    again = tune(tmp_path, "n_trials=1", *options)
    assert again.returncode == 0, again.stderr
    assert "1 trials over, 0 to do" in again.stdout
    shown = run_script("status", "experiment=smoke", f"output_dir={tmp_path}")
    assert "best so far: trial 0: unchanged (success_auc 0.0%)" in shown.stdout
    other = tune(tmp_path, "n_trials=1", *options, "total_timesteps=80")
    assert other.returncode == 2
    assert "base config" in other.stderr


@pytest.mark.slow
def test_a_whole_search_ends_with_a_config_that_train_takes_and_that_reproduces_the_winner(tmp_path):
    done = tune(tmp_path, "n_trials=3", "search.n_retest=1", TWO)
    assert done.returncode == 0, done.stderr
    assert states(tmp_path) == ["done"] * 3
    tested = read_json(tmp_path / "smoke" / "retest.json")
    assert [len(one["test"]) for one in tested["trials"]] == [2, 2]
    assert 0 in [one["number"] for one in tested["trials"]]
    path = tmp_path / "smoke" / "tuned_smoke.yaml"
    assert yaml.safe_load(path.read_text())["experiment_name"] == "tuned_smoke"
    trained = run_script("train", f"experiment={path}", "seed=1001", f"output_dir={tmp_path}", "tracking.mlflow=false")
    assert trained.returncode == 0, trained.stderr
    winner = tested["trials"][0]["number"]
    (fresh,) = tmp_path.glob("tuned_smoke/*/seed=1001")
    searched = tmp_path / trials(tmp_path)[winner].runs[0]
    assert searched.parent.name == fresh.parent.name
    assert (searched / "episodes.csv").read_bytes() == (fresh / "episodes.csv").read_bytes()


@pytest.mark.slow
def test_ctrl_c_leaves_everything_resumable(tmp_path):
    options = ("n_trials=3", "search.tuning_seeds=[1001]", "tracking.mlflow=false", TWO, *LONGER)
    process = begin(tmp_path, *options, **TUNE)
    wait_until(lambda: any(one["status"] == "running" for one in statuses(tmp_path).values()))
    time.sleep(3)
    os.kill(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 130, stderr
    assert workers(tmp_path) == []
    assert set(states(tmp_path)) <= {"pending", "done"}
    done = tune(tmp_path, *options)
    assert done.returncode == 0, done.stderr
    assert states(tmp_path) == ["done"] * 3


@pytest.mark.slow
def test_kills_at_random_moments_lose_no_trial_and_do_none_twice(tmp_path):
    options = ("n_trials=16", "search.tuning_seeds=[1001]", "tracking.mlflow=false", TWO)
    dice = random.Random(0)
    for attempt in range(30):
        process = begin(tmp_path, *options, **TUNE)
        if attempt % 2:  # one worker
            time.sleep(dice.uniform(4, 12))
            for pid in dice.sample(found, 1) if (found := workers(tmp_path)) else []:
                os.kill(pid, signal.SIGKILL)
        time.sleep(dice.uniform(2, 12))
        if process.poll() is None:  # the whole tuning
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        if process.returncode == 0:
            break
    done = tune(tmp_path, *options)
    assert done.returncode == 0, done.stderr
    assert attempt > 1
    found = trials(tmp_path)
    assert [trial.number for trial in found] == list(range(16))
    assert {trial.state for trial in found} <= {"done", "pruned"}
    paths = [tmp_path / path for trial in found for path in trial.runs]
    assert len(set(paths)) == len(list(tmp_path.glob("smoke/*/seed=*")))
    assert {read_state(path).stage for path in paths} <= {"done", "pruned"}
    for path in paths:  # every env step once
        steps = [line.split(",")[1] for line in (path / "episodes.csv").read_text().splitlines()[1:]]
        assert steps == sorted(steps, key=int)


@pytest.mark.slow
def test_two_tunings_at_once_share_a_study(tmp_path):
    options = ("n_trials=5", "search.tuning_seeds=[1001]", "tracking.mlflow=false", "n_workers=1")
    processes = [begin(tmp_path, *options, **TUNE) for _ in range(2)]
    codes = []
    for process in processes:
        process.communicate(timeout=300)
        codes.append(process.returncode)
    assert codes == [0, 0]
    assert states(tmp_path) == ["done"] * 5
    assert len(list(tmp_path.glob("smoke/*/seed=*/result.json"))) == len({p for t in trials(tmp_path) for p in t.runs})


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["local", "basic", "slurm"])
def test_every_launcher_trains_trials_of_a_study_in_a_database(tmp_path, launcher):
    executor = ["hydra.launcher.executor=local"] if launcher == "slurm" else []
    options = ["n_trials=2", "search.tuning_seeds=[1001]", "tracking.mlflow=false", "search.pruner=null", TWO]
    uri = f"sqlite:///{tmp_path}/study.db"
    objective = "search.objective=final_parked"
    done = tune(tmp_path, *options, f"storage={uri}", f"hydra/launcher={launcher}", *executor, objective)
    assert done.returncode == 0, done.stderr
    found = study_in(tmp_path / "smoke", uri).trials
    assert [(trial.state, trial.value) for trial in found] == [("done", 0.0)] * 2
    assert not (tmp_path / "smoke" / "study.journal").exists()

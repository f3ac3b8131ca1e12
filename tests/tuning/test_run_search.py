"""Whole searches in processes of their own: from the first call to the tuned config, cut off in every way."""

import os
import random
import re
import signal
import subprocess
import sys
import time

import pytest
import yaml
from support.runs import ROOT, run_script, script, store
from support.searches import QUICK
from support.sweep_processes import FAILING, statuses, wait_until, workers

from parking_exp.runs.files import read_json
from parking_exp.runs.state import read_state
from parking_exp.tuning.search import Search, study_in
from parking_exp.tuning.trials import rows

TWO = "n_workers=2"
LONGER = ("total_timesteps=3000", "checkpoint.every_n_steps=200")


def tune(output_dir, *arguments, **keywords):
    return run_script("tune", *QUICK, f"output_dir={output_dir}", *arguments, env=FAILING, timeout=600, **keywords)


def begin(output_dir, *arguments):
    command, keywords = script("tune", *QUICK, f"output_dir={output_dir}", *arguments, env=FAILING)
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, **keywords)


def trials(output_dir):
    found = study_in(output_dir / "smoke")
    return rows(found.study, output_dir / "smoke", found.n_trials)


def states(output_dir):
    return [trial.state for trial in trials(output_dir)]


@pytest.mark.slow
def test_a_dry_run_shows_space_budget_and_estimate_and_makes_nothing(tmp_path):
    done = tune(tmp_path / "outputs", "n_trials=8", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert re.search(r"^algorithm.policy_delay +1 … 3, whole   if algorithm=td3$", done.stdout, re.MULTILINE)
    assert "objective success_auc; sampler tpe, pruner median after 40 updates; trial 0 is the config" in done.stdout
    assert "8 trials x 3 seeds x 60 env steps at most" in done.stdout
    assert "0 trials over, 8 to do; no run has finished yet to tell the time by" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_search_of_one_trial_has_runs_with_tags_a_status_and_goes_on_when_typed_again(tmp_path):
    options = ("search.tuning_seeds=[1001]", "tracking.mlflow=true")
    done = tune(tmp_path, "n_trials=1", *options)
    assert done.returncode == 0, done.stderr
    (trial,) = trials(tmp_path)
    assert (trial.state, trial.changes, trial.values, trial.env_steps) == ("done", {}, [0.0], 60)
    (run,) = store(tmp_path).search_runs(["1"])
    assert {name: run.data.tags[name] for name in ("search", "trial", "seed")} == {
        "search": "smoke", "trial": "0", "seed": "1001",
    }  # fmt: skip
    again = tune(tmp_path, "n_trials=1", *options)
    assert again.returncode == 0, again.stderr
    assert "1 trials over, 0 to do" in again.stdout
    shown = run_script("status", "experiment=smoke", f"output_dir={tmp_path}")
    assert "best so far: trial 0: as it stands (success_auc 0.0%)" in shown.stdout
    other = tune(tmp_path, "n_trials=1", *options, "total_timesteps=80")
    assert other.returncode == 2
    assert "the base config" in other.stderr


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
    process = begin(tmp_path, *options)
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
        process = begin(tmp_path, *options)
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
    processes = [begin(tmp_path, *options) for _ in range(2)]
    codes = []
    for process in processes:
        process.communicate(timeout=300)
        codes.append(process.returncode)
    assert codes == [0, 0]
    assert states(tmp_path) == ["done"] * 5
    assert len(list(tmp_path.glob("smoke/*/seed=*/result.json"))) == len({p for t in trials(tmp_path) for p in t.runs})


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["basic", "slurm"])
def test_other_launchers_train_trials_as_well(tmp_path, launcher):
    executor = ["hydra.launcher.executor=local", "n_workers=2"] if launcher == "slurm" else []
    options = ["n_trials=2", "search.tuning_seeds=[1001]", "tracking.mlflow=false"]
    done = tune(tmp_path, *options, f"hydra/launcher={launcher}", *executor)
    assert done.returncode == 0, done.stderr
    assert states(tmp_path) == ["done"] * 2


@pytest.mark.slow
def test_two_objectives_are_both_recorded(tmp_path):
    options = ["n_trials=2", "search.tuning_seeds=[1001]", "tracking.mlflow=false", "search.pruner=null"]
    done = tune(tmp_path, *options, "search.objective=[success_auc,final_parked]")
    assert done.returncode == 0, done.stderr
    assert all(len(trial.values) == 2 for trial in trials(tmp_path))


@pytest.mark.slow
def test_a_trial_that_is_worse_than_the_median_is_pruned_and_stays_so(tmp_path):
    source = (
        "import sys\n"
        f"sys.path[:0] = [{str(ROOT)!r}, {str(ROOT / 'tests')!r}]\n"
        "import optuna\n"
        "from pathlib import Path\n"
        "from parking_exp.tuning import worker\n"
        "worker.make_pruner = lambda *_: optuna.pruners.ThresholdPruner(lower=0.5)\n"
        "from parking_exp.sweeps.supervisor import supervise\n"
        "worker.work(Path(sys.argv[1]), 2, lambda path, stop: supervise(path, stop=stop))\n"
    )
    options = ["search.tuning_seeds=[1001,1002]", "tracking.mlflow=false", "search.grace_updates=0", "n_trials=2"]
    search = Search([*QUICK, *options, f"output_dir={tmp_path}"])
    search.open()
    search.save()
    subprocess.run([sys.executable, "-c", source, str(search.folder)], check=True, timeout=300)
    assert states(tmp_path) == ["done", "pruned"]
    assert [len(trial.runs) for trial in trials(tmp_path)] == [2, 1]
    again = tune(tmp_path, *options)
    assert again.returncode == 0, again.stderr
    assert states(tmp_path) == ["done", "pruned"]

"""Whole searches: from the first call to the tuned config, interrupted in every way."""

import io
import os
import random
import shlex
import signal
import time

import pandas as pd
import pytest
import yaml
from rich.console import Console
from support.runs import call_script, refusal, run_script, store
from support.searches import QUICK, user_search
from support.sweep_processes import FAILING, begin, trained, workers

from parking_exp.config.compose import compose_runs
from parking_exp.config.validate import validate
from parking_exp.runs.foreign_files import read_json
from parking_exp.runs.run_state import read_state
from parking_exp.tuning.run_search import choose_trials, write_winner
from parking_exp.tuning.search import read_search
from parking_exp.tuning.trials import RetestedTrial, TrialRow

TWO = "n_workers=2"
TUNE = {"name": "tune", "options": QUICK}


def tune(output_dir, *arguments):
    return run_script(
        "tune", *QUICK, f"output_dir={output_dir}", *arguments, env=FAILING, timeout=600, code=0
    )


def trials(output_dir):
    return read_search(output_dir / "smoke").trials


def states(output_dir):
    return [trial.state for trial in trials(output_dir)]


def test_a_search_trains_its_trials_tags_their_runs_and_a_rerun_does_nothing(output_dir):
    options = (*QUICK, f"output_dir={output_dir}", "n_trials=1", "search.tuning_seeds=[1001]")
    call_script("tune", *options, code=0)
    (trial,) = trials(output_dir)
    assert (trial.state, trial.changes, trial.value, trial.by_seed) == ("done", {}, 0.0, [0.0])
    (run,) = store(output_dir).search_runs(["1"])
    tags = {"search": "smoke", "trial": "0", "seed": "1001"}
    assert {name: run.data.tags[name] for name in tags} == tags
    rerun = call_script("tune", *options, code=0)
    assert "1 trial over, 0 to do" in rerun.stdout
    status = call_script("status", "experiment=smoke", f"output_dir={output_dir}")
    assert "best so far: trial 0: unchanged (success_auc 0.0%)" in status.stdout


@pytest.mark.parametrize(
    ("n_retest", "values", "runs", "chosen"),
    [
        (2, [0.1, 0.9, None, 0.5, 0.9], "abcde", [0, 1, 4]),
        (9, [0.1, 0.9, None, 0.5, 0.9], "abcde", [0, 1, 4, 3]),
        (1, [None, 0.9], "ab", [1]),
        (3, [0.5, 0.9, 0.9, 0.9, 0.5], "abcba", [0, 1, 2]),  # some have the runs of another
    ],
)
def test_trial_0_and_the_best_of_the_others_are_retested(n_retest, values, runs, chosen):
    trials = []
    for number, (value, run) in enumerate(zip(values, runs, strict=True)):
        trials.append(TrialRow(number, "done" if value else "pruned", value=value, runs=[run]))
    assert [trial.number for trial in choose_trials(trials, n_retest)] == chosen


def test_the_winner_becomes_an_experiment_file_that_composes_to_its_config(tmp_path):
    """Also with options from a user's directory whose name has a space."""
    folder = tmp_path / "my conf"
    out = io.StringIO()
    (folder / "algorithm").mkdir(parents=True)
    (folder / "algorithm" / "mine.yaml").write_text("defaults:\n  - sac\n  - _self_\ntau: 0.03\n")
    search = user_search(folder, ["algorithm=mine", f"output_dir={tmp_path / 'out'}"])
    search.folder.mkdir(parents=True)
    winner = RetestedTrial(
        3, "trial 3: gamma=0.97", {"algorithm.gamma": 0.97}, [0.5, 0.7], [0.4, 0.6]
    )
    write_winner(search, [winner], Console(file=out, width=400))
    path = search.folder / "tuned_mine.yaml"
    content = yaml.safe_load(path.read_text())
    assert content["defaults"][1] == {"override /algorithm": "mine"}
    assert content["experiment_name"] == "tuned_mine"
    (run,) = compose_runs("config", [f"experiment={path}"], str(folder))
    assert validate(run.cell.config).cell_key == search.config({"algorithm.gamma": 0.97}).cell_key
    command = shlex.split(out.getvalue().splitlines()[-1])
    assert command[-3:] == [f"experiment={path}", "--config-dir", str(folder)]


@pytest.mark.slow
def test_training_the_written_experiment_reproduces_the_winner(tmp_path):
    tune(tmp_path, "n_trials=3", "search.n_retest=1", TWO)
    assert states(tmp_path) == ["done"] * 3
    tested = read_json(tmp_path / "smoke" / "retest.json")
    assert [len(trial["test"]) for trial in tested["trials"]] == [2, 2]
    assert 0 in [trial["number"] for trial in tested["trials"]]
    path = tmp_path / "smoke" / "tuned_smoke.yaml"
    assert yaml.safe_load(path.read_text())["experiment_name"] == "tuned_smoke"
    run_script(
        "train",
        f"experiment={path}",
        "seed=1001",
        f"output_dir={tmp_path}",
        "tracking.mlflow=false",
        code=0,
    )
    winner = tested["trials"][0]["number"]
    (fresh,) = tmp_path.glob("tuned_smoke/*/seed=1001")
    searched = tmp_path / trials(tmp_path)[winner].runs[0]
    assert searched.parent.name == fresh.parent.name
    assert (searched / "episodes.csv").read_bytes() == (fresh / "episodes.csv").read_bytes()


@pytest.mark.slow
def test_kills_at_random_moments_lose_no_trial_and_repeat_none(tmp_path):
    options = ("n_trials=16", "search.tuning_seeds=[1001]", "tracking.mlflow=false", TWO)
    dice = random.Random(0)
    for attempt in range(30):
        process = begin(tmp_path, *options, **TUNE)
        if attempt % 2:  # one worker
            time.sleep(dice.uniform(2, 6))
            for pid in workers(tmp_path)[:1]:
                os.kill(pid, signal.SIGKILL)
        time.sleep(dice.uniform(1, 5))
        if process.poll() is None:  # the whole tuning
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        if process.returncode == 0:
            break
    tune(tmp_path, *options)
    assert attempt > 1
    assert [trial.number for trial in trials(tmp_path)] == list(range(16))
    assert set(states(tmp_path)) <= {"done", "pruned"}
    paths = [tmp_path / path for trial in trials(tmp_path) for path in trial.runs]
    assert len(set(paths)) == len(list(tmp_path.glob("smoke/*/seed=*")))
    assert {read_state(path).stage for path in paths} <= {"done", "pruned"}
    for path in paths:  # every env step once
        assert pd.read_csv(path / "episodes.csv").iloc[:, 1].is_monotonic_increasing


@pytest.mark.slow
def test_two_calls_share_the_trials_of_a_study(tmp_path):
    options = ("n_trials=4", "search.tuning_seeds=[1001]", "tracking.mlflow=false", "n_workers=1")
    both = [begin(tmp_path, *options, **TUNE) for _ in range(2)]
    for process in both:
        _, stderr = process.communicate(timeout=300)
        assert process.returncode == 0, stderr
    assert states(tmp_path) == ["done"] * 4
    assert trained(tmp_path) == [1] * 4


@pytest.mark.usefixtures("srun")
def test_a_search_refuses_launchers_of_clusters(tmp_path):
    sentence = refusal("tune", *QUICK, f"output_dir={tmp_path}", "hydra/launcher=slurm")
    assert sentence.startswith("a search trains on this machine;")
    assert list(tmp_path.iterdir()) == []

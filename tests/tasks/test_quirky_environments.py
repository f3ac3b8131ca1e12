"""Environments whose quirks were reported to public projects: they train, or the run says why
not.
"""

import json
import subprocess
import sys

import pytest
from support import toy_tasks
from support.runs import ROOT, call_script, only_run

from parking_exp.config.compose import compose_configs
from parking_exp.config.validate import validate
from parking_exp.runs.metric_logs import METRICS_FILE, read_metrics
from parking_exp.tasks.registry import make_task
from parking_exp.training.seeds import derive_seeds

TOY = "support.toy_tasks:"
SHORT = (
    "env=gymnasium",
    "total_timesteps=400",
    "n_envs=1",
    "algorithm.learning_starts=64",
    "algorithm.net_arch=[8]",
    "evaluation.every_n_steps=null",
    "evaluation.n_scenes=2",
    "evaluation.final_n_scenes=3",
    "checkpoint.every_n_steps=null",
    "tracking.mlflow=false",
    "tracking.tensorboard=false",
)


def train(output_dir, name, *overrides):
    arguments = [*SHORT, f"env.id={TOY}{name}-v0", f"output_dir={output_dir}", *overrides]
    return call_script("train", *arguments)


def config(name, *overrides):
    (composed,) = compose_configs("config", [*SHORT, f"env.id={TOY}{name}-v0", *overrides])
    return validate(composed)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Blank", "no video: the environment renders NoneType instead of an array"),
        ("LosesContext", "RuntimeError: GL context lost"),
    ],
)
def test_a_run_whose_env_cannot_be_rendered_is_done_without_a_video(tmp_path, name, reason):
    done = train(tmp_path, name)
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stderr.splitlines() if "video" in line]
    assert reason in line
    directory = only_run(tmp_path)
    assert directory.status == "done"
    assert not (directory.path / "video.mp4").exists()
    evaluated = call_script(
        "evaluate",
        f"run={directory.path}",
        f"output_dir={tmp_path}",
        "episodes=1",
        "video=1",
        "trust=true",
    )
    assert (evaluated.returncode, reason in evaluated.stdout) == (0, True), evaluated.stderr


@pytest.mark.parametrize("name", ["CloseFails", "Wrapped", "SmallSeeds"])
def test_what_stable_baselines3_trains_is_trained(tmp_path, name):
    done = train(tmp_path, name, "evaluation.video_episodes=0")
    assert done.returncode == 0, done.stderr
    assert only_run(tmp_path).status == "done"


def test_seeds_of_training_fit_31_bits_and_are_no_seeds_of_evaluations():
    training = config("SmallSeeds").env.training_seeds
    assert (training.start, training.stop) == (2**30, 2**31 - 100_000)
    assert derive_seeds(0, training).training_envs in training
    with pytest.raises(ValueError, match="first_scene=1073741822 overlaps the training seeds"):
        config("SmallSeeds", f"evaluation.first_scene={2**30 - 2}")


def test_a_run_of_one_env_makes_few_instances_and_closes_them(tmp_path):
    toy_tasks.Counted.n_open = toy_tasks.Counted.n_most = 0
    done = train(tmp_path, "Counted", "evaluation.final_n_scenes=20", "evaluation.video_episodes=0")
    assert done.returncode == 0, done.stderr
    assert toy_tasks.Counted.n_most <= 8
    assert toy_tasks.Counted.n_open == 0


def test_an_env_of_a_notebook_trains_in_processes_of_its_own(tmp_path):
    own = ("env.id=Mine-v0", "env.vectorization=async", f"output_dir={tmp_path}")
    overrides = [*SHORT, *own]
    program = (
        "import gymnasium as gym\n"
        "from support.toy_tasks import BitFlip\n"
        "class Mine(BitFlip):\n"
        "    pass\n"
        "gym.register('Mine-v0', Mine, max_episode_steps=8)\n"
        "from parking_exp import compose, train\n"
        f"train(compose(*{overrides!r}))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT / "tests",
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert only_run(tmp_path).status == "done"


def test_a_process_of_an_env_that_ends_is_reported_in_a_sentence(tmp_path):
    done = train(tmp_path, "Exits", "env.vectorization=async", "evaluation.video_episodes=0")
    assert done.returncode == 2
    assert "EnvProcessError: the process of an env has ended" in done.stderr
    assert "env.vectorization=sync needs no processes" in done.stderr


def test_without_a_cross_check_there_are_no_certified_metrics(tmp_path):
    done = call_script(
        "train",
        "experiment=smoke",
        "evaluation.n_certified_scenes=0",
        "evaluation.video_episodes=0",
        "tracking.mlflow=false",
        f"output_dir={tmp_path}",
    )
    assert done.returncode == 0, done.stderr
    names = {
        name
        for record in read_metrics(only_run(tmp_path).path / METRICS_FILE)
        for name in record["metrics"]
    }
    assert "final/success_rate" in names
    assert not any(name.startswith("certified/") for name in names)


def test_a_task_has_the_metrics_of_its_own(tmp_path):
    train(tmp_path, "BitFlip", "evaluation.video_episodes=0")
    result = json.loads((only_run(tmp_path).path / "result.json").read_text())
    rates = {
        name for name in result["metrics"] if name.startswith("final/") and name.endswith("_rate")
    }
    assert rates == {"final/success_rate", "final/failure_rate", "final/timeout_rate"}
    assert make_task(config("BitFlip").env).failure == "failure"

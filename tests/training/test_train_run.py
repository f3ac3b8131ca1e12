"""A run from its config to its result, also after a kill or a failure."""

import json
import re
import shutil
import subprocess
import sys
import time

import pandas as pd
import pytest
import stable_baselines3
import torch
from stable_baselines3.common.results_plotter import load_results
from stable_baselines3.common.vec_env import VecMonitor
from support.runs import (
    artifacts,
    assert_store_is_whole,
    call_script,
    history,
    only_run,
    script,
    store,
    stored_params,
)
from support.sweep_processes import begin, wait_until

from parking_exp import __version__
from parking_exp.algorithms.build_model import GreedyPolicy, build_model
from parking_exp.algorithms.model_files import load_weights
from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError, FailedRunError, RunLockedError
from parking_exp.runs.directory import RunDirectory
from parking_exp.sweeps.single_run import train
from parking_exp.tasks.metrics import episode_columns
from parking_exp.tasks.parking.parking_metrics import METRICS
from parking_exp.tasks.parking.parking_task import ParkingTask
from parking_exp.tasks.parking.reward import ParkingReward
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs
from parking_exp.tracking.ui_addresses import ui_command
from parking_exp.training import checkpoints, run_session, training_session
from parking_exp.training.seeds import cross_checked_seeds

STEPS = [100, 200, 300, 400]
# The smoke run never parks or plans.
NEVER_MEASURED = ("park_s_mean", "path_efficiency_mean", "plan_s_mean")


def test_a_run_prints_its_progress_its_rates_with_intervals_and_its_directories(
    smoke, smoke_folder
):
    output, errors = json.loads((smoke_folder / "printed.json").read_text())
    assert re.search(
        r"^success +\d+\.\d%   95 % interval \d+\.\d% to \d+\.\d%   \d of 5$",
        output,
        re.MULTILINE,
    )
    assert f"run directory  {smoke.path}" in output
    assert f"MLflow run     {smoke.run_id}" in output
    assert "Traceback" not in errors
    lines = [line for line in errors.splitlines() if line.startswith("train ")]
    assert 3 <= len(lines) <= 11
    assert re.match(
        r"train  \d+/400 steps  success +\d+%  return +-?\d+\.\d  \d+ steps/s", lines[-1]
    )


def test_the_store_has_every_metric_of_an_evaluation(smoke):
    client = store(smoke.output_dir)
    for metric in METRICS:
        if metric.key in NEVER_MEASURED:
            continue
        assert [step for step, _ in history(client, smoke.run_id, f"eval/{metric.key}")] == STEPS
        assert [step for step, _ in history(client, smoke.run_id, f"final/{metric.key}")] == [400]
    for name in ("time/cpu_s", "time/wall_s"):
        values = [value for _, value in history(client, smoke.run_id, name)]
        assert values == sorted(values)
        assert len(values) == 4
    metrics = client.get_run(smoke.run_id).data.metrics
    assert {
        "rollout/success_rate",
        "rollout/ep_rew_mean",
        "rollout/ep_len_mean",
        "buffer/real_share",
        "train/critic_loss",
    } <= set(metrics)
    assert metrics["train/n_updates"] == pytest.approx(0.5 * (400 - 40), abs=10)
    assert_store_is_whole(smoke.output_dir, 400)


def test_the_store_has_the_resolved_config_and_what_was_run(smoke):
    data, config = store(smoke.output_dir).get_run(smoke.run_id).data, smoke.read_config()
    assert data.params == stored_params(config)
    assert data.params["algorithm._target_"] == "parking_exp.algorithms.SAC"
    assert data.params["env.observation.scales"] == "[100.0, 100.0, 5.0, 5.0, 1.0, 1.0]"
    tags = {
        "experiment": "smoke",
        "cell": config.cell_name,
        "seed": "0",
        "run_key": config.run_key,
        "status": "done",
        "version.parking-exp": __version__,
    }
    assert {name: data.tags[name] for name in tags} == tags
    for package in ("python", "torch", "stable-baselines3", "highway-env", "gymnasium"):
        assert re.match(r"\d+\.\d+", data.tags[f"version.{package}"])
    assert "git_commit" not in data.tags or re.fullmatch(r"[0-9a-f]{40}", data.tags["git_commit"])


def test_the_store_has_all_files_but_the_replay_buffer(smoke):
    client = store(smoke.output_dir)
    assert artifacts(client, smoke.run_id) == [
        "checkpoint/model.zip", "config.yaml", "curves.png", "episodes.csv", "metrics.jsonl",
        "models/best.zip", "models/final.zip", "monitor.csv", "paths.csv.gz", "progress.csv",
        "video.mp4",
    ]  # fmt: skip


def test_the_first_final_episodes_have_paths_as_long_as_they_are(smoke):
    final = pd.read_csv(smoke.path / "episodes.csv").query("phase == 'final'")
    paths = pd.read_csv(smoke.path / "paths.csv.gz")
    last_steps = paths.groupby("scene")["step"].max()
    assert last_steps.to_dict() == dict(zip(final["scene"], final["steps"], strict=True))


def test_episodes_have_one_row_each_and_the_final_ones_are_certified_on_highway_env(smoke):
    table = pd.read_csv(smoke.path / "episodes.csv")
    assert list(table.columns) == ["phase", "step", *episode_columns(METRICS)]
    scenes = table.groupby(["phase", "step"])["scene"].agg(list).to_dict()
    during = {("eval", step): [0, 1, 2] for step in STEPS}
    assert scenes == {
        **during,
        ("final", 400): [0, 1, 2, 3, 4],
        ("certified", 400): [0, 1, 2, 3, 4],
    }
    table = table.set_index("phase").drop(columns="step")
    pd.testing.assert_frame_equal(
        table.loc["final"], table.loc["certified"].rename({"certified": "final"})
    )
    metrics = smoke.read_result().metrics
    of_all = [metric.key for metric in METRICS if metric.key not in NEVER_MEASURED]
    for key in of_all:
        assert metrics[f"certified/{key}"] == metrics[f"final/{key}"]


def test_some_final_scenes_drawn_by_the_seed_are_certified(tmp_path):
    config = compose(
        "experiment=smoke", "evaluation.n_certified_scenes=2", "evaluation.video_episodes=0",
        "tracking.mlflow=false", f"output_dir={tmp_path}", "total_timesteps=100",
    )  # fmt: skip
    result = train(config)
    table = pd.read_csv(config.run_dir / "episodes.csv").drop(columns="step").set_index("phase")
    final, certified = (table.loc[phase].set_index("scene") for phase in ("final", "certified"))
    assert final.index.tolist() == [0, 1, 2, 3, 4]
    assert certified.index.tolist() == cross_checked_seeds(config) == [1, 4]
    assert cross_checked_seeds(config.model_copy(update={"seed": 1})) == [0, 1]
    pd.testing.assert_frame_equal(final.loc[certified.index], certified)
    assert result.metrics["final/steps_mean"] == final["steps"].mean()
    assert result.metrics["certified/steps_mean"] == certified["steps"].mean()
    assert (result.run_id, result.steps) == (None, 100)
    assert not (tmp_path / "mlflow.db").exists()


def test_a_simulator_that_differs_from_highway_env_fails_the_run(output_dir, monkeypatch):
    """Here the simulator gives other rewards in the final scenes; both tables are stored."""
    original = ParkingReward.__call__

    def other(self, achieved, desired, info=None):
        reward, reached = original(self, achieved, desired, info)
        return reward - 1e-6, reached

    monkeypatch.setattr(ParkingReward, "__call__", other)
    config = compose(
        "experiment=smoke",
        f"output_dir={output_dir}",
        "evaluation.video_episodes=0",
        "n_envs=1",
        "total_timesteps=100",
    )
    with pytest.raises(
        FailedRunError, match=r"5 of 5 cross-checked episodes differ .* scene 0: return -\d"
    ):
        train(config)
    directory = only_run(output_dir)
    assert directory.status == "failed"
    assert directory.read_result() is None
    run = store(output_dir).get_run(directory.run_id)
    assert run.info.status == "FAILED"
    # The same command resumes from the last checkpoint: what came after that is not final.
    assert not {"final/return_mean", "certified/return_mean"} & set(run.data.metrics)
    stored = pd.read_csv(store(output_dir).download_artifacts(directory.run_id, "episodes.csv"))
    assert set(stored["phase"]) == {"eval", "final", "certified"}


def test_stable_baselines3_reads_the_logs_and_the_model(smoke):
    path = smoke.path
    config = smoke.read_config()
    monitor = load_results(str(path))
    assert set(monitor.columns) >= {"r", "l", "t", "is_success", "crashed"}
    assert monitor["l"].max() == 11  # training_duration of 2 s
    assert pd.read_csv(path / "progress.csv")["eval/success_rate"].notna().sum() == 4
    (board,) = (path / "tensorboard").iterdir()
    assert board.name == "sac, her_future"
    task = make_task(config.env)
    env = make_training_envs(task, 1)
    observation, plain = env.reset(), stable_baselines3.SAC.load(path / "models" / "final.zip")
    ours = build_model(config, task, env, seed=1, for_training=False)
    load_weights(path / "models" / "final.zip", ours)
    assert (
        plain.predict(observation, deterministic=True)[0] == GreedyPolicy(ours)(observation)
    ).all()


def test_a_finished_run_is_not_rerun_even_if_its_files_were_deleted(smoke_copy):
    shutil.rmtree(smoke_copy.models)
    (smoke_copy.path / "metrics.jsonl").unlink()
    before = sorted(smoke_copy.path.rglob("*"))
    again = call_script("train", "experiment=smoke", f"output_dir={smoke_copy.output_dir}", code=0)
    assert again.stdout.startswith("already done")
    assert sorted(smoke_copy.path.rglob("*")) == before
    assert (
        train(compose("experiment=smoke", f"output_dir={smoke_copy.output_dir}"))
        == smoke_copy.read_result()
    )


def test_the_command_of_a_finished_run_makes_a_lost_store_again(smoke_copy):
    (smoke_copy.output_dir / "mlflow.db").unlink()
    shutil.rmtree(smoke_copy.output_dir / "mlflow-artifacts")
    config = compose("experiment=smoke", f"output_dir={smoke_copy.output_dir}")
    result = train(config)
    assert_store_is_whole(smoke_copy.output_dir, config.total_timesteps)
    assert result.run_id == smoke_copy.run_id


def test_a_killed_run_resumes_in_the_same_mlflow_run_without_repeated_steps(
    output_dir, monkeypatch
):
    arguments = (
        "experiment=smoke",
        "checkpoint.every_n_steps=50",
        "evaluation.video_episodes=0",
        "algorithm._target_=support.user_algorithms.Lingers",  # slow enough to be killed on the way
    )
    process = begin(output_dir, *arguments, options=())
    wait_until(lambda: len(list(output_dir.glob("*/*/*/checkpoints/step=*"))) == 2)
    time.sleep(0.5)  # into the steps after a checkpoint
    process.kill()
    process.wait()
    directory = only_run(output_dir)
    killed_at, run_id = checkpoints.latest(directory.checkpoints).name, directory.run_id
    assert directory.status == "running"
    monkeypatch.setattr("support.user_algorithms.Lingers.pause_s", 0)
    done = call_script("train", *arguments, f"output_dir={output_dir}", code=0)
    assert f"resuming at step {int(killed_at.removeprefix('step='))}" in done.stderr
    assert (directory.run_id, directory.status) == (run_id, "done")
    assert_store_is_whole(output_dir, 400)


def test_a_missing_device_is_refused_before_anything_is_on_disk(tmp_path):
    device = f"cuda:{torch.cuda.device_count()}"
    with pytest.raises(ConfigError, match=f"^device={device}"):
        train(compose("experiment=smoke", f"output_dir={tmp_path}", f"device={device}"))
    assert list(tmp_path.iterdir()) == []


def test_two_processes_do_not_work_on_one_run(tmp_path):
    config = compose("experiment=smoke", f"output_dir={tmp_path}")
    with (
        RunDirectory(config.run_dir).supervisor_lock(),
        pytest.raises(RunLockedError, match="another process"),
    ):
        train(config)


@pytest.mark.parametrize(
    ("module", "failing", "made"),
    [
        (run_session, "make_logger", ["task"]),
        (training_session, "make_training_envs", ["task"]),
        (training_session, "build_model", ["envs", "task"]),
    ],
)
def test_what_a_training_has_made_is_closed_if_it_fails_while_it_is_made(
    tmp_path, monkeypatch, module, failing, made
):
    closed = []

    def fail(*_, **__):
        raise RuntimeError("out of memory")

    config = compose(
        "experiment=smoke", f"output_dir={tmp_path}", "tracking.mlflow=false", "n_envs=2"
    )
    monkeypatch.setattr(ParkingTask, "close", lambda _: closed.append("task"))
    monkeypatch.setattr(VecMonitor, "close", lambda _: closed.append("envs"))
    monkeypatch.setattr(module, failing, fail)

    with pytest.raises(FailedRunError, match="out of memory"):
        train(config)

    assert closed == made


@pytest.mark.slow
def test_a_full_disk_under_a_checkpoint_fails_the_run_without_a_traceback(tmp_path):
    """A limit of file sizes stands in for it: the replay buffer grows beyond it."""
    command, keywords = script(
        "train",
        "experiment=smoke",
        f"output_dir={tmp_path}",
        "tracking.mlflow=false",
        "evaluation.video_episodes=0",
        "evaluation.every_n_steps=null",
        "updates_per_step=0.1",
        "total_timesteps=4000",
        "checkpoint.every_n_steps=400",
        "tracking.tensorboard=false",
    )
    limited = ["bash", "-c", 'ulimit -f 120; exec "$@"', "_", *command]
    failed = subprocess.run(limited, check=False, capture_output=True, timeout=180, **keywords)
    assert failed.returncode == 2
    assert "Traceback" not in failed.stderr
    assert "OSError: [Errno 27] File too large" in failed.stderr
    directory = only_run(tmp_path)
    status, traceback = directory.read_status(), (directory.path / "traceback.txt").read_text()
    assert status.status == "failed"
    assert "File too large" in status.error
    assert traceback.startswith("Traceback")
    assert "File too large" in traceback
    assert not [*directory.path.rglob(".tmp-*")]
    kept = [
        int(folder.name.removeprefix("step=")) for folder in directory.path.glob("checkpoints/*")
    ]
    done = subprocess.run(command, check=False, capture_output=True, timeout=180, **keywords)
    assert done.returncode == 0, done.stderr
    assert f"resuming at step {max(kept)}" in done.stderr


@pytest.mark.parametrize(
    ("started", "uri", "command"),
    [
        ("scripts/train.py", "sqlite:///{here}/outputs/mlflow.db", "make ui"),
        (
            "scripts/train.py",
            "sqlite:////else/mlflow.db",
            "make ui STORE=sqlite:////else/mlflow.db",
        ),
        (
            "bin/parking-train",
            "sqlite:////a b.db",
            "mlflow ui --workers 1 --backend-store-uri 'sqlite:////a b.db'",
        ),
        ("my_study.py", "http://host:5000", "http://host:5000"),
    ],
)
def test_the_way_to_the_ui_is_that_of_the_store_and_of_the_installation(
    started, uri, command, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [started])
    assert ui_command(uri.format(here=tmp_path)) == command

"""A run from its config to its result: what it leaves behind, and that nothing is lost when it is cut off."""

import errno
import os
import re
import shutil
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pandas as pd
import pytest
import stable_baselines3
import torch
from omegaconf import OmegaConf
from PIL import Image, ImageSequence
from support.runs import (
    artifacts,
    assert_store_is_whole,
    history,
    make_config,
    only_run,
    run_script,
    script,
    store,
    type_here,
    wait_for,
)
from support.sweep_processes import FAILING

from parking_exp import __version__
from parking_exp.algorithms.build import build_model, greedy_policy
from parking_exp.algorithms.model_files import load_weights
from parking_exp.config.compose import composed
from parking_exp.envs.reward import GoalReward
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import (
    ConfigError,
    FailedRunError,
    InterruptedRunError,
    ModelError,
    RunLockedError,
    RunNotFoundError,
)
from parking_exp.evaluation.evaluate_policy import evaluate
from parking_exp.evaluation.evaluate_run import evaluate_run
from parking_exp.evaluation.metrics import EPISODE_COLUMNS
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.files import read_json, sha256
from parking_exp.tracking.sync import flatten
from parking_exp.training import checkpoints, loop
from parking_exp.training.finish import certified_scenes
from parking_exp.training.train_run import train

EVALUATED = [
    "success_rate", "crash_rate", "timeout_rate", "parked_rate", "return_mean", "steps_mean", "distance_m_mean",
    "heading_error_rad_mean", "speed_mps_mean",
]  # fmt: skip


def test_a_run_prints_rates_with_intervals_and_where_things_are(smoke):
    directory, process, _ = smoke
    assert re.search(
        r"^success +\d+\.\d%   95 % interval \d+\.\d% to \d+\.\d%   \d of 5$", process.stdout, re.MULTILINE
    )
    assert f"run directory  {directory.path}" in process.stdout
    assert f"MLflow run     {directory.run_id}" in process.stdout
    assert "Traceback" not in process.stderr


def test_without_a_terminal_progress_comes_as_lines(smoke):
    lines = [line for line in smoke[1].stderr.splitlines() if line.startswith("train ")]
    assert 3 <= len(lines) <= 11
    assert re.match(r"train  \d+/400 steps  success +\d+%  return +-?\d+\.\d  \d+ steps/s", lines[-1])


def test_the_store_has_every_metric_of_an_evaluation(smoke):
    directory, _, output_dir = smoke
    client = store(output_dir)
    for name in EVALUATED:
        assert [step for step, _ in history(client, directory.run_id, f"eval/{name}")] == [100, 200, 300, 400]
        assert [step for step, _ in history(client, directory.run_id, f"final/{name}")] == [400]
    for name in ("time/cpu_s", "time/wall_s"):
        values = [value for _, value in history(client, directory.run_id, name)]
        assert values == sorted(values)
        assert len(values) == 4
    metrics = set(client.get_run(directory.run_id).data.metrics)
    assert {"rollout/success_rate", "rollout/ep_rew_mean", "rollout/ep_len_mean", "train/critic_loss"} <= metrics
    assert_store_is_whole(output_dir, 400)


def test_the_share_of_real_transitions_is_logged(smoke):
    """n_sampled_goal is 2, so that a third is real, and so is what may have no virtual goal."""
    directory, _, output_dir = smoke
    shares = history(store(output_dir), directory.run_id, "buffer/real_share")
    assert len(shares) >= 4
    with np.load(checkpoints.latest(directory.checkpoints) / checkpoints.BUFFER) as buffer:
        real, virtual = buffer["sampled"]
    assert shares[-1] == (400, pytest.approx(real / (real + virtual)))
    assert all(1 / 3 <= share < 1 for _, share in shares)


def test_the_stores_parameters_are_the_resolved_config(smoke):
    directory, _, output_dir = smoke
    params = store(output_dir).get_run(directory.run_id).data.params
    assert params == flatten(directory.config().plain())
    assert params["algorithm._target_"] == "parking_exp.algorithms.SAC"
    assert params["algorithm.net_arch"] == "[16, 16]"
    assert params["env.observation.scales"] == "[100.0, 100.0, 5.0, 5.0, 1.0, 1.0]"


def test_the_stores_tags_say_what_was_run(smoke):
    directory, _, output_dir = smoke
    tags = store(output_dir).get_run(directory.run_id).data.tags
    config = directory.config()
    assert tags["experiment"] == "smoke"
    assert tags["cell"] == config.cell
    assert tags["seed"] == "0"
    assert tags["run_key"] == config.run_key
    assert tags["status"] == "done"
    assert tags["version.parking-exp"] == __version__
    for package in ("python", "torch", "stable-baselines3", "highway-env", "gymnasium"):
        assert re.match(r"\d+\.\d+", tags[f"version.{package}"])
    assert tags["cpu"]
    assert "git_commit" not in tags or re.fullmatch(r"[0-9a-f]{40}", tags["git_commit"])
    assert ("git_commit" in tags) == ("git_dirty" in tags)


def test_the_stores_artifacts_are_all_there(smoke):
    directory, _, output_dir = smoke
    assert artifacts(store(output_dir), directory.run_id) == [
        "checkpoints/step=0000000300/model.zip",
        "checkpoints/step=0000000300/replay_buffer.json",
        "checkpoints/step=0000000400/model.zip",
        "checkpoints/step=0000000400/replay_buffer.json",
        "config.yaml",
        "curves.png",
        "episodes.csv",
        "metrics.jsonl",
        "models/best.zip",
        "models/final.zip",
        "monitor.csv",
        "progress.csv",
        "trajectories.npz",
        "video.mp4",
    ]


def test_the_store_knows_where_the_replay_buffer_is(smoke):
    directory, _, output_dir = smoke
    client = store(output_dir)
    stored = client.download_artifacts(directory.run_id, "checkpoints/step=0000000400/replay_buffer.json")
    record = read_json(Path(stored))
    assert record["path"] == "checkpoints/step=0000000400/replay_buffer.npz"  # in the run directory
    assert record["sha256"] == sha256(directory.checkpoints / "step=0000000400" / "replay_buffer.npz")


def test_episodes_have_one_row_each(smoke):
    table = pd.read_csv(smoke[0].path / "episodes.csv")
    assert list(table.columns) == ["phase", "step", *EPISODE_COLUMNS]
    counts = table.groupby(["phase", "step"])["scene"].agg(list).to_dict()
    during = {("eval", step): [0, 1, 2] for step in (100, 200, 300, 400)}
    assert counts == {**during, ("final", 400): [0, 1, 2, 3, 4], ("certified", 400): [0, 1, 2, 3, 4]}


def test_the_final_evaluation_is_certified_on_highway_env(smoke):
    directory, _, output_dir = smoke
    table = pd.read_csv(directory.path / "episodes.csv").set_index("phase").drop(columns="step")
    pd.testing.assert_frame_equal(table.loc["final"], table.loc["certified"].rename({"certified": "final"}))
    config = directory.config()
    model = build_model(config, make_training_envs(config.env, 1), seed=0, for_training=False)
    load_weights(directory.models / "final.zip", model)
    theirs = evaluate(greedy_policy(model), config.env, range(5), simulator="highway_env")
    assert table.loc["certified", "return"].tolist() == pytest.approx(theirs["return"].tolist(), abs=1e-9)
    metrics = store(output_dir).get_run(directory.run_id).data.metrics
    for name, value in metrics.items():
        if name.startswith("certified/"):
            assert value == metrics[name.replace("certified/", "final/")]
    assert len([name for name in metrics if name.startswith("certified/")]) == 9


@pytest.mark.parametrize("seed", [0, 1])
def test_some_final_scenes_drawn_by_the_seed_are_certified(tmp_path, seed):
    arguments = ("evaluation.n_certified_scenes=2", "evaluation.video_episodes=0", "tracking.mlflow=false")
    config = make_config("experiment=smoke", f"seed={seed}", *arguments, f"output_dir={tmp_path}")
    metrics = train(config).metrics
    table = pd.read_csv(config.run_dir / "episodes.csv").drop(columns="step").set_index("phase")
    final, certified = (table.loc[phase].set_index("scene") for phase in ("final", "certified"))
    assert final.index.tolist() == [0, 1, 2, 3, 4]
    assert certified.index.tolist() == certified_scenes(config) == [[1, 4], [0, 1]][seed]
    pd.testing.assert_frame_equal(final.loc[certified.index], certified)
    assert metrics["final/steps_mean"] == final["steps"].mean()
    assert metrics["certified/steps_mean"] == certified["steps"].mean()


def test_a_simulator_that_differs_from_highway_env_fails_the_run(output_dir, monkeypatch):
    """Here ours is taught other rewards for the final scenes: the run fails, and says so; both tables are stored."""
    original = GoalReward.__call__

    def other(self, achieved, desired):
        reward, reached = original(self, achieved, desired)
        return reward - 1e-6, reached

    monkeypatch.setattr(GoalReward, "__call__", other)
    config = make_config("experiment=smoke", f"output_dir={output_dir}", "evaluation.video_episodes=0", "n_envs=1",
                         "total_timesteps=100")  # fmt: skip
    with pytest.raises(FailedRunError, match=r"5 of 5 certified episodes differ .* scene 0: return -\d"):
        train(config)
    directory = only_run(output_dir)
    assert directory.status == "failed"
    assert directory.result() is None
    run = store(output_dir).get_run(directory.run_id)
    assert run.info.status == "FAILED"
    # The run goes on from its last checkpoint when it is typed again: what came after that is not final.
    assert not {"final/return_mean", "certified/return_mean"} & set(run.data.metrics)
    stored = pd.read_csv(store(output_dir).download_artifacts(directory.run_id, "episodes.csv"))
    assert set(stored["phase"]) == {"eval", "final", "certified"}


@pytest.mark.slow
def test_trained_on_highway_env_a_run_is_certified_as_it_is(tmp_path):
    config = make_config(
        "experiment=smoke", f"output_dir={tmp_path}", "env.simulator=highway_env", "total_timesteps=100",
        "tracking.mlflow=false", "evaluation.video_episodes=0", "env.action.dynamical=true",
    )  # fmt: skip
    metrics = train(config).metrics
    assert metrics["certified/return_mean"] == metrics["final/return_mean"]


def test_the_metrics_are_those_of_the_episodes(smoke):
    directory, _, output_dir = smoke
    table = pd.read_csv(directory.path / "episodes.csv").query("phase == 'final'")
    metrics = store(output_dir).get_run(directory.run_id).data.metrics
    assert metrics["final/distance_m_mean"] == pytest.approx(table["distance_m"].mean())
    assert metrics["final/timeout_rate"] == (table["outcome"] == "timeout").mean()


def test_the_video_decodes_and_has_every_frame(smoke):
    directory, _, _ = smoke
    frames = iio.imread(directory.path / "video.mp4", plugin="FFMPEG")
    episodes = pd.read_csv(directory.path / "episodes.csv").query("phase == 'final' and scene < 2")
    # Each episode: its start, three simulation frames a step, and a second of its end at 15 frames a second.
    assert len(frames) == sum(1 + 3 * steps + 15 for steps in episodes["steps"])
    assert frames.shape[1:] == (300, 600, 3)
    assert frames.std() > 10  # something is drawn


def test_sb3s_own_logs_are_there(smoke):
    from stable_baselines3.common.results_plotter import load_results
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    path = smoke[0].path
    monitor = load_results(str(path))
    assert set(monitor.columns) >= {"r", "l", "t", "is_success", "crashed"}
    assert monitor["l"].max() == 11  # training_duration of 2 s
    assert pd.read_csv(path / "progress.csv")["eval/success_rate"].notna().sum() == 4
    events = EventAccumulator(str(path / "tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("eval/success_rate")] == [100, 200, 300, 400]


def test_a_finished_run_is_not_run_again(smoke):
    directory, _, output_dir = smoke
    before = (directory.path / "metrics.jsonl").read_bytes()
    again = type_here("train", "experiment=smoke", f"output_dir={output_dir}")
    assert again.returncode == 0
    assert again.stdout.startswith("already done")
    assert (directory.path / "metrics.jsonl").read_bytes() == before
    assert len(store(output_dir).search_runs([store(output_dir).get_experiment_by_name("smoke").experiment_id])) == 1


def test_a_saved_model_is_a_plain_stable_baselines3_zip(smoke):
    directory, _, _ = smoke
    config = directory.config()
    env = make_training_envs(config.env, 1)
    observation = env.reset()
    plain = stable_baselines3.SAC.load(directory.models / "final.zip")
    ours = build_model(config, env, seed=1, for_training=False)
    load_weights(directory.models / "final.zip", ours)
    assert (plain.predict(observation, deterministic=True)[0] == greedy_policy(ours)(observation)).all()


@pytest.fixture
def finished(smoke, tmp_path):
    """A finished run of its own: its directory, and the arguments of its training."""
    shutil.copytree(smoke[2], tmp_path / "outputs")
    return only_run(tmp_path / "outputs"), ("experiment=smoke", f"output_dir={tmp_path / 'outputs'}")


def test_evaluate_prints_and_stores_episodes_and_a_video(finished, tmp_path):
    directory, output_dir = finished[0], tmp_path / "outputs"
    done = run_script(
        "evaluate", f"run={directory.run_id}", f"output_dir={output_dir}", "episodes=6", "video=2", "gif=true"
    )
    assert done.returncode == 0, done.stderr
    for name in ("success", "crash", "timeout", "parked"):
        assert re.search(rf"^{name} +\d+\.\d%   95 % interval", done.stdout, re.MULTILINE)
    assert re.search(r"steps, return .*, at the end .* m from the slot's centre, .* rad off, .* m/s", done.stdout)
    folder = directory.path / "evaluations" / "parking-final-scenes-0-5"
    table = pd.read_csv(folder / "episodes.csv")
    assert table["scene"].tolist() == [0, 1, 2, 3, 4, 5]
    frames = sum(1 + 3 * steps + 15 for steps in table["steps"][:2])
    assert len(iio.imread(folder / "video.mp4", plugin="FFMPEG")) == frames
    with Image.open(folder / "video.gif") as gif:  # frames that repeat are shown longer instead
        shown_ms = sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif))
    assert shown_ms == 200 * -(-frames // 3)
    stored = artifacts(store(output_dir), directory.run_id, f"evaluations/{folder.name}")
    assert [path.rpartition("/")[2] for path in stored] == ["episodes.csv", "summary.json", "video.gif", "video.mp4"]
    # The same model on the same scenes: what the run itself saw at its end.
    final = pd.read_csv(directory.path / "episodes.csv").query("phase == 'final'").reset_index(drop=True)
    pd.testing.assert_frame_equal(table.head(5), final[EPISODE_COLUMNS], rtol=1e-6)


@pytest.mark.slow
def test_evaluate_takes_a_directory_another_env_and_the_best_model(finished):
    directory, _ = finished
    done = run_script("evaluate", f"run={directory.path}", "episodes=2", "env=parking_crowded", "env.duration=2",
                      "model=best", "tracking.mlflow=false", "name=parked")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "best model on 2 scenes of parking_crowded" in done.stdout
    assert len(pd.read_csv(directory.path / "evaluations" / "parked" / "episodes.csv")) == 2


def evaluate_stored(directory, *arguments):
    (config,) = composed("evaluate", [f"run='{directory.path}'", "episodes=1", "simulator=vectorized", *arguments])
    return evaluate_run(config)


def test_a_finished_run_whose_files_were_deleted_stays_as_it_is(finished):
    directory, arguments = finished
    shutil.rmtree(directory.models), (directory.path / "metrics.jsonl").unlink()
    assert train(make_config(*arguments)) == directory.result()
    assert not directory.models.exists() and not (directory.path / "metrics.jsonl").exists()


def test_evaluate_says_how_to_get_a_model_that_is_gone(finished):
    directory, _ = finished
    (directory.models / "final.zip").unlink()
    with pytest.raises(RunNotFoundError, match=r"final\.zip .*model=best.* delete"):
        evaluate_stored(directory)
    (directory.models / "best.zip").unlink()
    with pytest.raises(RunNotFoundError, match=r"final\.zip .* delete"):
        evaluate_stored(directory)
    directory.update(status="interrupted")
    with pytest.raises(RunNotFoundError, match=r"final\.zip .* train"):
        evaluate_stored(directory)


@pytest.mark.slow
def test_evaluate_refuses_a_damaged_model_in_a_sentence(finished):
    """As a command, since nothing else shows that there is no traceback."""
    directory, _ = finished
    path = directory.models / "final.zip"
    os.truncate(path, 3000)
    done = run_script("evaluate", f"run={directory.path}", "episodes=1", "tracking.mlflow=false")
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {path} is damaged")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("algorithm.net_arch", [8, 8], "policy.actor.latent_pi.0.weight"),
        ("algorithm.ent_coef", 0.5, "it lacks ent_coef_tensor"),
    ],
)
def test_evaluate_refuses_a_model_that_is_not_its_configs(finished, key, value, problem):
    directory, _ = finished
    config = OmegaConf.load(directory.path / "config.yaml")
    OmegaConf.update(config, key, value)
    OmegaConf.save(config, directory.path / "config.yaml")
    with pytest.raises(ModelError, match=rf"final\.zip .* config\.yaml .*{re.escape(problem)}"):
        evaluate_stored(directory)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["run=nowhere"], "run=nowhere"),
        (["epsodes=3"], "epsodes"),
        (["episodes=0"], "episodes=0"),
        (["episodes=3", "video=5"], "video=5"),
        (["gif=true"], "gif=true"),
        (["model=last"], "model=last"),
        (["env.duration=2"], "env"),
        (["env=parking", "env.policy_frequency=20"], "env.policy_frequency=20"),
        (["algorithm=td3"], "algorithm"),
        (["env=parkin"], "env=parkin"),
    ],
)
def test_evaluate_refuses_in_a_sentence(smoke, arguments, named):
    done = type_here("evaluate", f"output_dir={smoke[2]}", *arguments)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {named}")
    assert done.stderr.count("\n") == 1


def test_a_killed_run_resumes_in_the_same_mlflow_run_with_no_step_twice(output_dir):
    arguments = (
        "experiment=smoke", f"output_dir={output_dir}", "total_timesteps=400", "evaluation.video_episodes=0",
        "algorithm._target_=support.failing_algorithms.Lingers",  # slow enough to be killed on the way
    )  # fmt: skip
    command, keywords = script("train", *arguments, env=FAILING)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **keywords)
    checkpoints = lambda: sorted(path.name for path in output_dir.glob("*/*/*/checkpoints/step=*"))  # noqa: E731
    wait_for(lambda: len(checkpoints()) == 2, process)
    time.sleep(0.5)  # into the steps after a checkpoint
    process.kill()
    process.wait()
    directory = only_run(output_dir)
    killed_at, run_id = checkpoints()[-1], directory.run_id
    assert directory.status == "running"

    done = type_here("train", *arguments)
    assert done.returncode == 0, done.stderr
    assert f"resuming at step {int(killed_at.removeprefix('step='))}" in done.stderr
    assert directory.run_id == run_id
    assert directory.status == "done"
    local = assert_store_is_whole(output_dir, 400)
    assert [step for step, _ in local["eval/success_rate"]] == [100, 200, 300, 400]
    updates = [value for _, value in local["train/n_updates"]]
    assert updates == sorted(set(updates))  # counters go on where they were
    assert updates[-1] == pytest.approx(0.5 * (400 - 40), abs=10)
    episodes = [value for _, value in local["time/episodes"]]
    assert episodes == sorted(set(episodes))
    assert checkpoints() == ["step=0000000300", "step=0000000400"]
    assert len(pd.read_csv(directory.path / "progress.csv")["eval/success_rate"].dropna()) == 4
    table = pd.read_csv(directory.path / "episodes.csv")
    assert not table.duplicated(["phase", "step", "scene"]).any()


@pytest.mark.slow
@pytest.mark.parametrize("signal_number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_saves_a_checkpoint_and_the_same_command_goes_on(tmp_path, signal_number):
    output_dir = tmp_path / "outputs"
    arguments = ("experiment=smoke", f"output_dir={output_dir}", "checkpoint.every_n_steps=null",
                 "evaluation.video_episodes=0", "evaluation.every_n_steps=null")  # fmt: skip
    command, keywords = script("train", *arguments)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **keywords)
    wait_for(lambda: any(output_dir.glob("*/*/*/metrics.jsonl")), process)
    process.send_signal(signal_number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + signal_number
    assert "rerun the same command to resume" in errors
    assert "Traceback" not in errors
    directory, client = only_run(output_dir), store(output_dir)
    (checkpoint,) = directory.checkpoints.iterdir()
    assert directory.status == "interrupted"
    run = client.get_run(directory.run_id)
    assert (run.info.status, run.data.tags["status"]) == ("KILLED", "interrupted")

    done = run_script("train", *arguments)
    assert done.returncode == 0, done.stderr
    assert f"resuming at step {int(checkpoint.name.removeprefix('step='))}" in done.stderr
    assert_store_is_whole(output_dir, 400)


@pytest.mark.slow
def test_a_corrupt_checkpoint_is_passed_over_with_a_warning(tmp_path):
    output_dir = tmp_path / "outputs"
    arguments = (
        "experiment=smoke", f"output_dir={output_dir}", "evaluation.video_episodes=0", "total_timesteps=300",
        "env.simulator=highway_env",  # slow enough to be killed on the way
    )  # fmt: skip
    command, keywords = script("train", *arguments)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **keywords)
    wait_for(lambda: len(list(output_dir.glob("*/*/*/checkpoints/step=*"))) == 2, process)
    time.sleep(1.0)  # so that the store has got what is going to be done again
    process.kill()
    process.wait()
    killed_id = only_run(output_dir).run_id
    *_, older, newer = sorted(only_run(output_dir).checkpoints.glob("step=*"))  # an older one may be about to go
    os.truncate(newer / "replay_buffer.npz", 1000)
    done = run_script("train", *arguments)
    assert done.returncode == 0, done.stderr
    assert f"checkpoint {newer} is passed over (replay_buffer.npz has changed); trying the one before it" in done.stderr
    assert f"resuming at step {int(older.name.removeprefix('step='))}" in done.stderr
    # The store had points of the corrupt checkpoint, and they can't be taken back: another MLflow run takes its place.
    assert store(output_dir).get_run(killed_id).info.lifecycle_stage == "deleted"
    assert_store_is_whole(output_dir, 300)


def test_a_run_that_fails_is_failed_in_the_store_with_its_traceback(output_dir):
    config = make_config(
        "experiment=smoke", f"output_dir={output_dir}", "algorithm._target_=support.failing_algorithms.Raises"
    )
    with pytest.raises(FailedRunError, match=r"the run failed: .*; its traceback is in .*traceback\.txt"):
        train(config)
    directory, client = RunDirectory(config.run_dir), store(output_dir)
    assert directory.status == "failed"
    run = client.get_run(directory.run_id)
    assert (run.info.status, run.data.tags["status"]) == ("FAILED", "failed")
    assert "traceback.txt" in artifacts(client, directory.run_id)
    assert (directory.path / "traceback.txt").read_text().startswith("Traceback")


@pytest.mark.slow
def test_a_run_that_broke_and_goes_on_has_one_trajectory_in_the_store(tmp_path, monkeypatch):
    config = make_config("experiment=smoke", f"output_dir={tmp_path}", "checkpoint.every_n_steps=150",
                         "evaluation.video_episodes=0", "tracking.progress_bar=false")  # fmt: skip
    save = checkpoints.save

    def full_disk(directory, model, progress, *rest):
        if progress.step >= 300:
            raise OSError(errno.ENOSPC, "No space left on device")
        return save(directory, model, progress, *rest)

    monkeypatch.setattr(checkpoints, "save", full_disk)
    with pytest.raises(FailedRunError, match="No space left on device"):
        train(config)
    directory = RunDirectory(config.run_dir)
    assert store(tmp_path).get_run(directory.run_id).info.status == "FAILED"
    monkeypatch.undo()
    train(config)
    assert not (directory.path / "traceback.txt").exists()
    assert_store_is_whole(tmp_path, 400)


@pytest.mark.slow
def test_a_relative_sqlite_uri_means_the_same_everywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = make_config("experiment=smoke", "total_timesteps=60", "evaluation.video_episodes=0",
                         "tracking.uri=sqlite:///my/store.db", "tracking.progress_bar=false")  # fmt: skip
    train(config)
    assert RunDirectory(config.run_dir).tracking_uri == f"sqlite:///{tmp_path / 'my' / 'store.db'}"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["my", "outputs"]


def test_a_device_that_is_not_there_is_refused_before_anything_is_made(tmp_path):
    device = f"cuda:{torch.cuda.device_count()}"
    with pytest.raises(
        ConfigError, match=f"^device={device}: torch finds no such device; the closest valid choice is auto$"
    ):
        train(make_config("experiment=smoke", f"output_dir={tmp_path}", f"device={device}"))
    assert list(tmp_path.iterdir()) == []


def test_two_processes_do_not_work_on_one_run(tmp_path):
    config = make_config("experiment=smoke", f"output_dir={tmp_path}")
    with (
        RunDirectory(config.run_dir).supervisor_lock(),
        pytest.raises(RunLockedError, match="another process is working on"),
    ):
        train(config)


@pytest.mark.slow
def test_a_disk_that_fills_up_fails_the_run_and_keeps_what_was_there(tmp_path):
    """A file-size limit stands in for a full disk: the checkpoint's buffer does not fit."""
    output_dir = tmp_path / "outputs"
    arguments = ("experiment=smoke", f"output_dir={output_dir}", "tracking.mlflow=false", "tracking.tensorboard=false",
                 "evaluation.video_episodes=0", "checkpoint.keep_last=1", "total_timesteps=1200",
                 "checkpoint.every_n_steps=400")  # fmt: skip
    command, keywords = script("train", *arguments)
    limited = ["bash", "-c", 'ulimit -f 120; exec "$@"', "_", *command]  # in KiB: the third checkpoint is too large
    failed = subprocess.run(limited, check=False, capture_output=True, timeout=180, **keywords)
    assert failed.returncode == 2
    assert "error: the run failed: OSError: [Errno 27] File too large" in failed.stderr
    directory = only_run(output_dir)
    assert directory.status == "failed"
    (kept,) = directory.checkpoints.iterdir()
    done = run_script("train", *arguments)
    assert done.returncode == 0, done.stderr
    assert f"resuming at step {int(kept.name.removeprefix('step='))}" in done.stderr


@pytest.fixture
def small_disk(tmp_path):
    """A function that makes a disk of so many KiB, to be filled."""
    disk = tmp_path / "disk"
    disk.mkdir()

    def mount(kib):
        command = ["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(disk)]
        if not shutil.which("mount") or subprocess.run(command, check=False, capture_output=True).returncode:
            pytest.skip("nothing can be mounted here")
        return disk

    yield mount
    if disk.is_mount():
        subprocess.run(["umount", "-l", str(disk)], check=True)


def assert_failed_on_a_full_disk(path, reason="No space left on device"):
    status = read_json(path / "status.json")
    assert status["status"] == "failed"
    assert reason in status["error"]
    assert (path / "traceback.txt").read_text().startswith("Traceback")
    assert reason in (path / "traceback.txt").read_text()
    assert not (path / ".reserve").exists()
    assert not [*path.rglob(".tmp-*")]


@pytest.mark.slow
@pytest.mark.parametrize("kib", [100, 250])
def test_on_a_full_disk_a_run_leaves_its_reason_and_its_traceback(small_disk, kib):
    """What fills it first: the best model, and a checkpoint."""
    disk = small_disk(kib)
    failed = run_script("train", "experiment=smoke", f"output_dir={disk}", "tracking.mlflow=false")
    assert failed.returncode == 2
    assert "Traceback" not in failed.stderr
    assert "error: the run failed: OSError: [Errno 28] No space left on device" in failed.stderr
    assert_failed_on_a_full_disk(only_run(disk).path)
    told = type_here("status", f"output_dir={disk}").stdout
    assert re.search(
        r"^failed   parking-sac-her_future-\w+ seed=0: OSError: \[Errno 28\] No space left", told, re.MULTILINE
    )


@pytest.mark.slow
def test_a_sweep_on_a_disk_that_fills_up_meanwhile_says_why_its_runs_failed(small_disk):
    """And goes on when there is room again."""
    disk = small_disk(3000)
    arguments = ("experiment=smoke", f"output_dir={disk}", "total_timesteps=1200", "tracking.mlflow=false", "seeds=2",
                 "evaluation.final_n_scenes=2", "evaluation.n_scenes=2", "evaluation.every_n_steps=null", "evaluation.video_episodes=0", "env.simulator=highway_env")  # fmt: skip
    command, keywords = script("train", *arguments)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **keywords)
    wait_for(lambda: len({path.parents[1] for path in disk.glob("*/*/*/checkpoints/step=*")}) == 2, process)
    with suppress(OSError), (disk / "filler").open("wb", buffering=0) as filler:
        while filler.write(bytes(4096)):
            pass
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    assert "Traceback" not in errors
    for seed in (0, 1):
        assert re.search(rf"^failed   \S+ seed={seed}: .*No space left on device", output, re.MULTILINE)
    for path in disk.glob("*/*/seed=*"):
        assert_failed_on_a_full_disk(path)
    (disk / "filler").unlink()
    again = run_script("train", *arguments, "retry=failed")
    assert again.returncode == 0, again.stderr


@pytest.mark.slow
def test_a_full_disk_under_tensorboard_fails_the_run_without_a_traceback(tmp_path):
    """A file-size limit stands in for it, that only the file of events outgrows."""
    command, keywords = script(
        "train", "experiment=smoke", f"output_dir={tmp_path}", "tracking.mlflow=false", "total_timesteps=4000",
        "evaluation.every_n_steps=null", "checkpoint.every_n_steps=null", "tracking.csv=false",
        "tracking.log_interval=1", "updates_per_step=0.1",
    )  # fmt: skip
    limited = ["bash", "-c", 'ulimit -f 65; exec "$@"', "_", *command]
    failed = subprocess.run(limited, check=False, capture_output=True, timeout=180, **keywords)
    assert failed.returncode == 2
    assert "Traceback" not in failed.stderr
    assert "error: the run failed: OSError: [Errno 27] File too large" in failed.stderr
    directory = only_run(tmp_path)
    assert_failed_on_a_full_disk(directory.path, "File too large")
    assert (directory.path / "metrics.jsonl").stat().st_size < 65 * 1024
    (events,) = (directory.path / "tensorboard").iterdir()
    assert events.stat().st_size == 65 * 1024


def test_a_run_has_room_for_its_end_until_that_is_written(tmp_path, monkeypatch):
    """Real bytes, while it trains; none of them afterwards, however it ends."""
    config = make_config("experiment=smoke", f"output_dir={tmp_path}", "tracking.mlflow=false", "total_timesteps=60",
                         "tracking.progress_bar=false", "evaluation.video_episodes=0")  # fmt: skip
    reserve, seen = RunDirectory(config.run_dir).path / ".reserve", []

    def end(error):
        def learn(self):
            seen.append(reserve.stat().st_blocks * 512)
            raise error

        return learn

    stopped = InterruptedRunError("stopped", signal.SIGINT)
    for error, raised in ((RuntimeError(), FailedRunError), (stopped, InterruptedRunError)):
        with monkeypatch.context() as patch, pytest.raises(raised):
            patch.setattr(loop.TrainingLoop, "learn", end(error))
            train(config)
        assert not reserve.exists()
    assert min(seen) >= 64 * 1024
    train(config)
    assert not reserve.exists()


@pytest.mark.slow
def test_without_mlflow_everything_else_is_there(tmp_path):
    result = train(make_config("experiment=smoke", f"output_dir={tmp_path}", "tracking.mlflow=false",
                               "total_timesteps=100", "tracking.progress_bar=false"))  # fmt: skip
    assert result.run_id is None
    assert result.steps == 100
    assert "final/success_rate" in result.metrics
    assert not (tmp_path / "mlflow.db").exists()

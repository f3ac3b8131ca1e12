"""Benchmark training: the tutorial's recipe against plain Stable-Baselines3, and the overhead of a run."""

import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from typing import Any

from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.monitor import Monitor

from benchmarks.timing import interleave, rounded, spread
from benchmarks.updates import with_sb3_classes
from parking_exp.algorithms.build_model import build_model, torch_settings
from parking_exp.config.compose import composed
from parking_exp.config.paths import store_uri
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate
from parking_exp.envs.highway import make_env
from parking_exp.envs.interface import Policy
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.runs.directory import RunDirectory
from parking_exp.tracking.tracker import open_tracker
from parking_exp.training.finish import finish
from parking_exp.training.loop import RolloutCallback, TrainingLoop
from parking_exp.training.signals import StopRequest


def run_config(*overrides: str) -> RunConfig:
    """Return the validated config of a run."""
    (config,) = composed("config", list(overrides))
    return validate(config)


def tutorial(rounds: int, steps: int) -> dict[str, Any]:
    """Compare training steps per second of the tutorial's recipe, over `steps` on each side after a warm-up."""
    config = run_config("experiment=tutorial", "torch_threads=1")
    ours = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    peer = tutorial_model(config, seed=0)
    for model in (ours, peer):
        model.set_logger(Logger(None, []))
        model.learn(config.algorithm.arguments["learning_starts"])

    def our_side() -> float:
        with torch_settings(config):
            return _learn(ours, steps // rounds)

    entry = interleave(our_side, lambda: _learn(peer, steps // rounds), rounds)
    return entry | {
        "peer": "plain stable-baselines3 + highway-env",
        "unit": "env steps",
        "steps": steps,
        "precision": config.precision,
    }


def tutorial_model(config: RunConfig, seed: int) -> SAC:
    """Return the model of `experiment=tutorial` in plain Stable-Baselines3 and highway-env."""
    arguments = config.algorithm.arguments
    return SAC(
        "MultiInputPolicy",
        Monitor(make_env(config.env)),
        learning_rate=arguments["learning_rate"],
        learning_starts=arguments["learning_starts"],
        batch_size=arguments["batch_size"],
        gamma=arguments["gamma"],
        policy_kwargs={"net_arch": list(config.algorithm.net_arch)},
        buffer_size=config.buffer.buffer_size,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs=with_sb3_classes(config).buffer.arguments,
        seed=seed,
        device="cpu",
    )


def overhead(rounds: int, steps: int, slice_steps: int, *changes: str) -> tuple[dict[str, Any], Policy]:
    """Measure the overhead of the default run over its training; also return the trained policy.

    A tracked run is trained for `steps`, and its parts are timed; slices of its training alternate with slices of a
    bare training. The ratio is that of a default run of full length, composed of these parts: start, training with
    logging, evaluations, checkpoints, and the end with cross-check, figures, video and artifacts.

    Args:
        rounds: number of slices.
        steps: env steps of the tracked run.
        slice_steps: env steps per slice.
        changes: overrides of the timed run.
    """
    full = run_config()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        overrides = [f"output_dir={folder}/out", "tracking.progress_bar=false", *changes]
        config = run_config(*overrides, f"total_timesteps={steps}")
        _make_store(config)
        stack.enter_context(RunDirectory(config.run_dir).training_lock())
        loop, start_s = _tracked_loop(config)
        loop.learn()
        bare = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
        bare.set_logger(Logger(None, []))
        bare.learning_starts = steps  # fills its buffer equally
        bare.learn(steps)
        bare.learning_starts = 0
        loop.config = run_config(
            *overrides,
            f"total_timesteps={100 * steps}",
            "evaluation.every_n_steps=null",
            "checkpoint.every_n_steps=null",
        )
        callback = RolloutCallback(loop)
        slices = []
        for _ in range(rounds):
            tracked_s = _seconds(lambda: _learn(loop.model, slice_steps, callback, config.tracking.log_interval))
            slices.append((tracked_s / slice_steps, _seconds(lambda: _learn(bare, slice_steps)) / slice_steps))
        loop.config = config
        evaluation_s = statistics.median(_seconds(loop.evaluate) for _ in range(rounds))
        checkpoint_s = statistics.median(_checkpoint_seconds(loop) for _ in range(rounds))
        policy = loop.policy
        with loop.average.applied():
            end_s = _seconds(lambda: finish(loop))
        loop.directory.update(status="done")
        loop.tracker.close()
        if problem := loop.directory.unsynced:  # the timed checkpoints and end would be incomplete
            raise RuntimeError(f"the store of the timed run is incomplete: {problem}")
    evaluations = full.total_timesteps // (full.evaluation.every_n_steps or full.total_timesteps)
    checkpoints = full.total_timesteps // (full.checkpoint.every_n_steps or full.total_timesteps)
    rest = start_s + (evaluations - 1) * evaluation_s + checkpoints * checkpoint_s + end_s
    # Random steps before the first update cost next to nothing.
    learned = full.total_timesteps - full.algorithm.arguments["learning_starts"]
    ratios = [(learned * tracked + rest) / (learned * bare) for tracked, bare in slices]
    parts = {
        "training_s": learned * statistics.median(bare for _, bare in slices),
        "rows_and_callbacks_s": learned * statistics.median(tracked - bare for tracked, bare in slices),
        "start_s": start_s,
        "evaluations_s": (evaluations - 1) * evaluation_s,
        "checkpoints_s": checkpoints * checkpoint_s,
        "end_s": end_s,
    }
    entry = spread(ratios, "ratio") | {"peer": "the same training, bare", "unit": "wall time of the default run"}
    return entry | {"parts": {name: rounded(value) for name, value in parts.items()}}, policy


def _make_store(config: RunConfig) -> None:
    """Create the store, which exists in all runs but the first."""
    code = f"from parking_exp.tracking.client import connect; connect({store_uri(config)!r})"
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def _tracked_loop(config: RunConfig) -> tuple[TrainingLoop, float]:
    directory = RunDirectory(config.run_dir)
    start = time.perf_counter()
    directory.create(config)
    directory.update(status="running")
    loop = TrainingLoop(config, directory, open_tracker(config, directory), None, StopRequest())
    return loop, time.perf_counter() - start


def _checkpoint_seconds(loop: TrainingLoop) -> float:
    loop.progress.step = -1  # as if training had gone on
    return _seconds(loop.save_checkpoint)


def _learn(model: Any, steps: int, callback: BaseCallback | None = None, log_interval: int | None = None) -> float:
    before = model.num_timesteps
    model.learn(steps, callback, log_interval=log_interval or 10, reset_num_timesteps=False)
    return model.num_timesteps - before


def _seconds(task: Any) -> float:
    start = time.perf_counter()
    task()
    return time.perf_counter() - start

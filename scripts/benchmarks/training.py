"""Benchmark training: two recipes against plain Stable-Baselines3, and the overhead of a run."""

import io
import tempfile
from contextlib import redirect_stdout
from functools import partial
from typing import Any

import numpy as np
from stable_baselines3 import SAC, TD3, HerReplayBuffer
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.noise import NormalActionNoise

from benchmarks.timing import interleave, rounded, seconds, spread
from benchmarks.updates import sb3_classes
from parking_exp import compose
from parking_exp.algorithms.build_model import build_model
from parking_exp.algorithms.torch_settings import torch_settings
from parking_exp.config.schema import RunConfig
from parking_exp.sweeps.single_run import train
from parking_exp.tasks.parking.highway import make_parking_env
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs


def tutorial(rounds: int, steps: int) -> dict[str, Any]:
    """Compare training steps per second of Stable-Baselines3's example.

    Each side trains for `steps` after a warm-up.
    """
    options = ("experiment=tutorial", "torch_threads=1")
    config = compose(*options)
    env: Any = config.env
    peer = _sb3_model(compose(*options, *sb3_classes("sac")), SAC, Monitor(make_parking_env(env)))
    return _training_rates(config, peer, rounds, steps) | {
        "peer": "plain stable-baselines3 + highway-env"
    }


def fetch_reach(rounds: int, steps: int) -> dict[str, Any]:
    """Compare CPU time per env step of FetchReach, updates included, with equal settings."""
    options = ("env=fetch_reach", "algorithm=td3", "algorithm.normalize=false", "torch_threads=1")
    config = compose(*options)
    env: Any = config.env
    envs = make_vec_env(env.id, config.n_envs)
    peer = _sb3_model(compose(*options, *sb3_classes("td3")), TD3, envs)
    entry = _training_rates(config, peer, rounds, steps)
    times = {
        name: rounded(1 / entry[key])
        for name, key in zip(
            ("value", "lowest", "highest"), ("value", "highest", "lowest"), strict=True
        )
    }
    return entry | times | {"peer": "plain stable-baselines3", "unit": "CPU-s per env step"}


def _training_rates(config: RunConfig, peer: Any, rounds: int, steps: int) -> dict[str, Any]:
    """Compare env steps per second of training a config with those of a peer's model."""
    ours = _model(config)
    for model in (ours, peer):
        model.set_logger(Logger(None, []))
        model.learn(config.algorithm.arguments["learning_starts"])

    def learn(model: Any) -> float:
        before = model.num_timesteps
        model.learn(steps // rounds, reset_num_timesteps=False)
        return model.num_timesteps - before

    def our_side() -> float:
        with torch_settings(config):
            return learn(ours)

    return interleave(our_side, lambda: learn(peer), rounds) | {"unit": "env steps"}


def overhead(rounds: int, *changes: str) -> dict[str, Any]:
    """Compare the default run's wall time with training without logs, checkpoints, evaluation."""
    ratios = []
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
        options = (f"output_dir={folder}", "tracking.progress_bar=false", *changes)
        train(compose("experiment=smoke", *options))  # makes the store
        for seed in range(rounds):
            config = compose(f"seed={seed}", *options)
            ratios.append(seconds(partial(train, config)) / seconds(partial(_bare, config)))
    return spread(ratios) | {
        "peer": "the same training, bare",
        "unit": "wall time of the default run",
    }


def _bare(config: RunConfig) -> None:
    """Train without logs, checkpoints and evaluation."""
    with torch_settings(config):
        model = _model(config)
        model.set_logger(Logger(None, []))
        model.learn(config.total_timesteps)


def _model(config: RunConfig) -> Any:
    task = make_task(config.env)
    envs = make_training_envs(task, config.n_envs)
    return build_model(config, task, envs, seed=config.seed)


def _sb3_model(config: RunConfig, algorithm: type, envs: Any) -> Any:
    """Return a config's model with Stable-Baselines3's own classes, and none of this package's."""
    arguments = dict(config.algorithm.arguments)
    if noise := arguments.get("action_noise"):
        size = envs.action_space.shape
        arguments["action_noise"] = NormalActionNoise(
            np.full(size, noise["mean"]), np.full(size, noise["sigma"])
        )
    train_freq, gradient_steps = config.update_round()
    names = ("learning_rate", "learning_starts", "batch_size", "gamma", "tau", "action_noise")
    return algorithm(
        "MultiInputPolicy",
        envs,
        **{name: arguments[name] for name in names},
        train_freq=train_freq,
        gradient_steps=gradient_steps,
        policy_kwargs={"net_arch": list(config.algorithm.net_arch or ())},
        buffer_size=config.buffer.buffer_size,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs=config.buffer.arguments,
        seed=0,
        device="cpu",
    )

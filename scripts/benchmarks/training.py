"""Benchmark training: the tutorial's recipe against plain Stable-Baselines3, and the overhead of a run."""

import io
import tempfile
from contextlib import redirect_stdout
from functools import partial
from typing import Any

from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.monitor import Monitor

from benchmarks.timing import interleave, seconds, spread
from benchmarks.updates import sb3_classes
from parking_exp import compose
from parking_exp.algorithms.build_model import build_model, torch_settings
from parking_exp.config.schema import RunConfig
from parking_exp.tasks.parking.highway import make_env
from parking_exp.tasks.training_envs import make_training_envs
from parking_exp.training.train_run import train


def tutorial(rounds: int, steps: int) -> dict[str, Any]:
    """Compare training steps per second of the tutorial's recipe, over `steps` on each side after a warm-up."""
    config = compose("experiment=tutorial", "torch_threads=1")
    ours, peer = _model(config), _tutorial_model()
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

    entry = interleave(our_side, lambda: learn(peer), rounds)
    return entry | {"peer": "plain stable-baselines3 + highway-env", "unit": "env steps"}


def overhead(rounds: int, *changes: str) -> dict[str, Any]:
    """Compare the wall time of the default run with that of its training without logs, checkpoints and evaluation."""
    ratios = []
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
        options = (f"output_dir={folder}", "tracking.progress_bar=false", *changes)
        train(compose("experiment=smoke", *options))  # makes the store
        for seed in range(rounds):
            config = compose(f"seed={seed}", *options)
            ratios.append(seconds(partial(train, config)) / seconds(partial(_bare, config)))
    return spread(ratios) | {"peer": "the same training, bare", "unit": "wall time of the default run"}


def _bare(config: RunConfig) -> None:
    """Train without logs, checkpoints and evaluation."""
    with torch_settings(config):
        model = _model(config)
        model.set_logger(Logger(None, []))
        model.learn(config.total_timesteps)


def _model(config: RunConfig) -> Any:
    return build_model(config, make_training_envs(config.env, config.n_envs), seed=config.seed)


def _tutorial_model() -> SAC:
    """Return the model of `experiment=tutorial` in plain Stable-Baselines3 and highway-env."""
    config = compose("experiment=tutorial", *sb3_classes("sac"))
    env: Any = config.env
    arguments = config.algorithm.arguments
    return SAC(
        "MultiInputPolicy",
        Monitor(make_env(env)),
        **{name: arguments[name] for name in ("learning_rate", "learning_starts", "batch_size", "gamma")},
        policy_kwargs={"net_arch": list(config.algorithm.net_arch)},
        buffer_size=config.buffer.buffer_size,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs=config.buffer.arguments,
        seed=0,
        device="cpu",
    )

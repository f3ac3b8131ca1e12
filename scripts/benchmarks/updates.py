"""Benchmark the fast update, sampling included, against `train()` of Stable-Baselines3 and sbx."""

from typing import Any

from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from benchmarks.timing import interleave
from parking_exp import compose
from parking_exp.algorithms.build_model import build_model
from parking_exp.algorithms.torch_settings import torch_settings
from parking_exp.config.argument_limits import RELABEL_OPTIONS
from parking_exp.config.schema import RunConfig
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs


def updates(
    algorithm: str, net: str, rounds: int, *, peer: str, gradient_steps: int, quick: bool
) -> dict[str, Any]:
    """Compare updates per second with a peer, `stable-baselines3` or `sbx`.

    Our wide networks have precision=medium; the peer has torch's or JAX's default.
    """
    widths = [int(width) for width in net.split("x")]  # 3x256: three layers of 256 units
    is_wide = widths[1] >= 128
    options = [
        f"algorithm={algorithm}",
        f"algorithm.net_arch={[widths[1]] * widths[0]}",
        "algorithm.batch_size=256",
    ]
    options += [
        "n_envs=8",
        f"updates_per_step={gradient_steps / 8}",
        "algorithm.learning_starts=1000",
    ]
    if is_wide:
        options.append("precision=medium")
    if is_wide or peer == "sbx":
        # As in experiment=tutorial; sbx has no other features.
        options.append("algorithm.features=raw")
    config = compose(*options)
    transitions = 2000 if quick else 10_000
    ours = _filled(config, transitions)
    if peer == "sbx":
        theirs = _sbx_model(config, ours, gradient_steps)
    else:
        theirs = _filled(compose(*options, *sb3_classes(algorithm)), transitions)
    if quick:
        n_updates = 4
    elif is_wide:
        n_updates = 16
    else:
        n_updates = 80
    calls = max(1, n_updates // gradient_steps)

    def train(model: OffPolicyAlgorithm) -> float:
        for _ in range(calls):
            model.train(gradient_steps=gradient_steps, batch_size=ours.batch_size)
        return calls * gradient_steps

    def our_side() -> float:
        with torch_settings(config):
            return train(ours)

    return interleave(our_side, lambda: train(theirs), rounds) | {"peer": peer, "unit": "updates"}


def sb3_classes(algorithm: str) -> list[str]:
    """Return the overrides that select Stable-Baselines3's algorithm and HER buffer."""
    deleted = [f"~buffer.{key}" for key in RELABEL_OPTIONS]
    algorithm_class = f"algorithm._target_=stable_baselines3.{algorithm.upper()}"
    return [algorithm_class, "buffer._target_=stable_baselines3.HerReplayBuffer", *deleted]


def _filled(config: RunConfig, transitions: int) -> Any:
    """Return a model with a filled replay buffer."""
    task = make_task(config.env)
    envs = make_training_envs(task, config.n_envs)
    model = build_model(config, task, envs, seed=0)
    model.set_logger(Logger(None, []))
    model.learning_starts = transitions
    model.learn(transitions)
    model.learning_starts = 0
    return model


def _sbx_model(config: RunConfig, ours: Any, gradient_steps: int) -> Any:
    """Return the model in sbx (Stable-Baselines3 in JAX), which samples from our replay buffer."""
    import sbx

    model = getattr(sbx, config.algorithm.name.upper())(
        "MultiInputPolicy",
        make_training_envs(make_task(config.env), config.n_envs),
        learning_rate=1e-3,
        batch_size=ours.batch_size,
        tau=ours.tau,
        gamma=ours.gamma,
        buffer_size=config.n_envs,
        gradient_steps=gradient_steps,
        policy_kwargs={"net_arch": list(config.algorithm.net_arch or ())},
        seed=0,
    )
    model.set_logger(Logger(None, []))
    model.replay_buffer = ours.replay_buffer
    return model

"""Benchmark the fast update, sampling included, against `train()` of Stable-Baselines3 and sbx."""

from typing import Any

import stable_baselines3
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from benchmarks.timing import interleave
from parking_exp.algorithms.build_model import build_model, torch_settings
from parking_exp.config.argument_limits import RELABEL_OPTIONS
from parking_exp.config.schema import RunConfig
from parking_exp.envs.training_envs import make_training_envs

PEER = "stable-baselines3"
SBX = "sbx, with our replay buffer"


def updates(config: RunConfig, rounds: int, updates_a_slice: int, transitions: int = 10_000) -> dict[str, Any]:
    """Compare updates per second with Stable-Baselines3, in rounds of the config's length.

    Ours uses the config's matmul precision, the peer torch's default.
    """
    ours, peer = filled(config, fast=True, transitions=transitions), filled(config, fast=False, transitions=transitions)
    return _compare(config, ours, peer, rounds, updates_a_slice) | {"peer": PEER}


def updates_against_sbx(
    config: RunConfig, rounds: int, updates_a_slice: int, transitions: int = 10_000
) -> dict[str, Any]:
    """Compare updates per second with sbx (Stable-Baselines3 in JAX), which samples from our replay buffer.

    sbx concatenates the observation's parts, as `algorithm.features=raw` does. Options other than batch size, tau and
    gamma are sbx's defaults.

    Raises:
        ImportError: the extra `bench` is not installed.
    """
    import sbx

    ours = filled(config, fast=True, transitions=transitions)
    _, gradient_steps = config.update_rounds()
    peer = getattr(sbx, config.algorithm.name.upper())(
        "MultiInputPolicy",
        make_training_envs(config.env, config.n_envs),
        learning_rate=1e-3,
        batch_size=ours.batch_size,
        tau=ours.tau,
        gamma=ours.gamma,
        buffer_size=config.n_envs,
        gradient_steps=gradient_steps,
        policy_kwargs={"net_arch": list(config.algorithm.net_arch)},
        seed=0,
    )
    peer.set_logger(Logger(None, []))
    peer.replay_buffer = ours.replay_buffer
    return _compare(config, ours, peer, rounds, updates_a_slice) | {"peer": SBX}


def _compare(
    config: RunConfig, ours: OffPolicyAlgorithm, peer: OffPolicyAlgorithm, rounds: int, updates_a_slice: int
) -> dict[str, Any]:
    """Time `train` of both models with the same batch size; ours with the precision of the config."""
    _, gradient_steps = config.update_rounds()
    calls = max(1, updates_a_slice // gradient_steps)

    def our_side() -> float:
        with torch_settings(config):
            return side(ours)

    def side(model: OffPolicyAlgorithm) -> float:
        for _ in range(calls):
            model.train(gradient_steps=gradient_steps, batch_size=ours.batch_size)
        return calls * gradient_steps

    about = {"unit": "updates", "precision": config.precision, "peer_precision": "highest"}
    return interleave(our_side, lambda: side(peer), rounds) | about


def filled(config: RunConfig, fast: bool, transitions: int = 10_000) -> Any:
    """Return a model with a filled replay buffer, of our classes (fast) or Stable-Baselines3's."""
    if not fast:
        config = with_sb3_classes(config)
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    assert isinstance(model, getattr(stable_baselines3, config.algorithm.target.rpartition(".")[2]))
    model.set_logger(Logger(None, []))
    model.learning_starts = transitions
    model.learn(transitions)
    model.learning_starts = 0
    return model


def with_sb3_classes(config: RunConfig) -> RunConfig:
    """Return the config with Stable-Baselines3's algorithm and HER buffer."""
    algorithm = config.algorithm.model_copy(
        update={"target": f"stable_baselines3.{config.algorithm.target.rpartition('.')[2]}"}
    )
    plain = config.buffer.model_dump(by_alias=True, exclude=set(RELABEL_OPTIONS))
    buffer = type(config.buffer).model_validate(plain | {"_target_": "stable_baselines3.HerReplayBuffer"})
    return config.model_copy(update={"algorithm": algorithm, "buffer": buffer})

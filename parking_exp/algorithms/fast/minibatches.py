"""Minibatches of several updates, sampled from the replay buffer together and turned into features
once.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import torch
from stable_baselines3.common.buffers import DictReplayBuffer, ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.her import HerReplayBuffer

from parking_exp.buffers import HerBuffer
from parking_exp.tasks.feature_extractors import SymmetricFeatures

# Their `sample` draws transitions independently, so one large sample has the distribution of
# several small ones.
INDEPENDENT = (HerBuffer, HerReplayBuffer, ReplayBuffer, DictReplayBuffer)
MAX_MINIBATCHES = (
    64  # minibatches sampled together: all updates after a long episode would not fit into memory
)


class Minibatch(NamedTuple):
    """A minibatch of B transitions.

    Attributes:
        features: of the observations, then of the next ones, shape (2 B, features).
        actions: shape (B, actions).
        rewards: shape (B, 1).
        discounts: of the next state's value: gamma, or 0 where the episode terminated; shape (B,
            1).
        next_signs: of the next actions, -1 where a mirrored observation turns them around; shape
            (B, actions).
    """

    features: torch.Tensor
    actions: torch.Tensor
    rewards: torch.Tensor
    discounts: torch.Tensor
    next_signs: torch.Tensor


def sample_minibatches(
    model: OffPolicyAlgorithm, steps: int, batch_size: int
) -> Iterator[Minibatch]:
    """Sample the minibatches of `steps` updates, and yield them one by one.

    Buffers known to draw independently are sampled once for all of them. HER returns virtual
    transitions last; dealt out in turn, each minibatch has its share of them, to within one
    transition.
    """
    for first in range(0, steps, MAX_MINIBATCHES):
        yield from _sample(model, min(MAX_MINIBATCHES, steps - first), batch_size)


def _sample(model: OffPolicyAlgorithm, steps: int, batch_size: int) -> Iterator[Minibatch]:
    buffer, normalize = model.replay_buffer, model._vec_normalize_env
    assert buffer is not None
    if steps > 1 and type(buffer) in INDEPENDENT and "sample" not in vars(buffer):
        data: Any = buffer.sample(steps * batch_size, env=normalize)
        if len(data.rewards) == steps * batch_size:
            return _collate(model, [data], steps)
    return _collate(model, [buffer.sample(batch_size, env=normalize) for _ in range(steps)], steps)


def _collate(model: Any, samples: list[Any], steps: int) -> Iterator[Minibatch]:
    """Make one minibatch of each sample, or deal out one large sample."""

    def deal(parts: Sequence[torch.Tensor]) -> torch.Tensor:
        """Return shape (steps, B, ...)."""
        if len(parts) == steps:
            return torch.stack(list(parts))
        (rows,) = parts
        return rows.unflatten(0, (-1, steps)).transpose(0, 1)

    before, after, *others = map(
        deal, zip(*(_tensors(model, data) for data in samples), strict=True)
    )
    return map(
        Minibatch, torch.cat([before, after], dim=1), *(tensor.contiguous() for tensor in others)
    )


def _tensors(model: Any, data: Any) -> tuple[torch.Tensor, ...]:
    """Return the fields of a `Minibatch` for a sample, with features and next features apart."""
    extractor, actions, next_signs = (
        model.actor.features_extractor,
        data.actions,
        torch.ones_like(data.actions),
    )
    if isinstance(extractor, SymmetricFeatures):
        actions = extractor.mirror(actions, data.observations)
        next_signs = extractor.mirror(next_signs, data.next_observations)
    gamma = model.gamma if getattr(data, "discounts", None) is None else data.discounts
    features, next_features = (
        model.actor.extract_features(part, extractor)
        for part in (data.observations, data.next_observations)
    )
    return features, next_features, actions, data.rewards, (1 - data.dones) * gamma, next_signs

"""Minibatches of several updates, sampled together and turned into features once."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch

from parking_exp.buffers import HerBuffer
from parking_exp.tasks.feature_extractors import SymmetricFeatures

# Sampled together: all updates after a long episode would not fit into memory.
MAX_MINIBATCHES = 64


class Minibatch(NamedTuple):
    """A minibatch of B transitions.

    Attributes:
        features: of the observations, then of the next ones, shape (2 B, features).
        actions: shape (B, actions).
        rewards: shape (B, 1).
        discounts: of the next state's value, shape (B, 1): gamma, or 0 where the episode
            terminated.
        next_signs: of the next actions, shape (B, actions): -1 where a mirrored observation turns
            them around.
    """

    features: torch.Tensor
    actions: torch.Tensor
    rewards: torch.Tensor
    discounts: torch.Tensor
    next_signs: torch.Tensor


def sample_minibatches(model: Any, steps: int, batch_size: int) -> Iterator[Minibatch]:
    """Sample the minibatches of `steps` updates, and yield them one by one.

    `HerBuffer` draws transitions independently, so it is sampled once for all of them. It returns
    virtual transitions last. Dealt out in turn, each minibatch has its share of them, to within one
    transition.
    """
    for first in range(0, steps, MAX_MINIBATCHES):
        yield from _sample(model, min(MAX_MINIBATCHES, steps - first), batch_size)


def _sample(model: Any, steps: int, batch_size: int) -> Iterator[Minibatch]:
    buffer = model.replay_buffer
    if type(buffer) is HerBuffer:
        tensors = _tensors(model, buffer.sample(steps * batch_size))
        dealt = [rows.unflatten(0, (-1, steps)).transpose(0, 1) for rows in tensors]
    else:
        normalize = model._vec_normalize_env
        samples = [buffer.sample(batch_size, env=normalize) for _ in range(steps)]
        fields = zip(*[_tensors(model, sample) for sample in samples], strict=True)
        dealt = [torch.stack(parts) for parts in fields]

    features, next_features, *others = dealt
    both = torch.cat([features, next_features], dim=1)
    return map(Minibatch, both, *[tensor.contiguous() for tensor in others])


def _tensors(model: Any, sample: Any) -> tuple[torch.Tensor, ...]:
    """Return the fields of a `Minibatch` for a sample, with features and next features apart."""
    extractor = model.actor.features_extractor
    features = model.actor.extract_features(sample.observations, extractor)
    next_features = model.actor.extract_features(sample.next_observations, extractor)

    actions = sample.actions
    next_signs = torch.ones_like(actions)
    if isinstance(extractor, SymmetricFeatures):
        actions = extractor.mirror(actions, sample.observations)
        next_signs = extractor.mirror(next_signs, sample.next_observations)

    gamma = model.gamma if sample.discounts is None else sample.discounts
    discounts = (1 - sample.dones) * gamma
    return features, next_features, actions, sample.rewards, discounts, next_signs

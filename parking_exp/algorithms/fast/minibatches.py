"""Minibatches of several updates, sampled together and turned into features once."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch

from parking_exp.tasks.feature_extractors import SymmetricFeatures

# Sampled together: all updates after a long episode would not fit into memory.
MAX_MINIBATCHES = 64


class Minibatch(NamedTuple):
    """A minibatch of B transitions.

    Attributes:
        features: features of the observations, then of the next ones, shape (2 B, features).
        actions: shape (B, actions).
        rewards: shape (B, 1).
        discounts: factors of the next state's value, shape (B, 1): gamma, or 0 where the
            episode terminated.
        next_signs: signs of the next actions, shape (B, actions): -1 where a mirrored
            observation turns them around.
    """

    features: torch.Tensor
    actions: torch.Tensor
    rewards: torch.Tensor
    discounts: torch.Tensor
    next_signs: torch.Tensor


def sample_minibatches(model: Any, steps: int, batch_size: int) -> Iterator[Minibatch]:
    """Sample the minibatches of `steps` updates, and yield them one by one.

    `HerBuffer` samples transitions independently, so one sample serves many updates. It has real
    transitions first, then virtual ones, then demonstrated ones. They are dealt out in turn, so
    each minibatch has its share of each kind, to within one transition.
    """
    for first in range(0, steps, MAX_MINIBATCHES):
        yield from _sample(model, min(MAX_MINIBATCHES, steps - first), batch_size)


def _sample(model: Any, steps: int, batch_size: int) -> Iterator[Minibatch]:
    sample = model.replay_buffer.sample(steps * batch_size, env=model._vec_normalize_env)
    extractor = model.actor.features_extractor
    features = model.actor.extract_features(sample.observations, extractor)
    next_features = model.actor.extract_features(sample.next_observations, extractor)

    actions = sample.actions
    next_signs = torch.ones_like(actions)
    if isinstance(extractor, SymmetricFeatures):
        actions = extractor.mirror(actions, sample.observations)
        next_signs = extractor.mirror(next_signs, sample.next_observations)
    discounts = (1 - sample.dones) * model.gamma

    dealt = []
    for rows in (features, next_features, actions, sample.rewards, discounts, next_signs):
        dealt.append(rows.unflatten(0, (-1, steps)).transpose(0, 1))
    both = torch.cat(dealt[:2], dim=1)
    return map(Minibatch, both, *[rows.contiguous() for rows in dealt[2:]])

"""Exponential moving average (EMA) of an actor's weights: a policy that is steadier than the one that is trained."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import torch
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from parking_exp.algorithms.model_files import read_weights
from parking_exp.errors import ConfigError

ACTOR = "actor."  # prefix of the names of the actor's weights in a policy


class PolicyEMA:
    """Exponential moving average of the weights of a model's actor over its gradient updates.

    It begins with the weights after the first round of updates, and includes the statistics of batch normalisation.

    Args:
        model: a Stable-Baselines3 model with an actor.
        half_life: in gradient updates; None: no average, the actor as it is.

    Raises:
        ConfigError: the model's policy has no actor.
    """

    def __init__(self, model: OffPolicyAlgorithm, half_life: float | None) -> None:
        self.model, self.half_life = model, half_life
        weights = model.policy.state_dict().items()
        self._names = [name for name, weight in weights if name.startswith(ACTOR) and weight.is_floating_point()]
        if half_life is not None and not self._names:
            raise ConfigError(f"algorithm.policy_ema_half_life: {type(model).__name__} has no actor; use null")
        self._weights: list[torch.Tensor] = []
        self._updates = 0

    def update(self) -> None:
        """Take in the updates that the model has made since the last call."""
        if self.half_life is None or (new := self.model._n_updates - self._updates) <= 0:
            return
        if self._weights:
            for average, trained in zip(self._weights, self._actor(), strict=True):
                average.lerp_(trained, 1 - 0.5 ** (new / self.half_life))
        else:
            self._weights = [weight.clone() for weight in self._actor()]
        self._updates = self.model._n_updates

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Give the model's actor the averaged weights within a block."""
        self.update()
        trained = [weight.clone() for weight in self._actor()]
        self._set_actor(self._weights or trained)
        try:
            yield
        finally:
            self._set_actor(trained)

    def load(self, path: Path) -> None:
        """Restore the average from a model file that was saved while it was applied; the model is as it was then.

        Raises:
            DamagedModelError: the file cannot be read.
        """
        if self.model._n_updates:  # otherwise there was nothing to average yet
            policy = read_weights(path, self.model.device)["policy"]
            self._weights = [policy[name] for name in self._names]
            self._updates = self.model._n_updates

    def _actor(self) -> list[torch.Tensor]:
        weights = self.model.policy.state_dict()
        return [weights[name] for name in self._names]

    def _set_actor(self, weights: Sequence[torch.Tensor]) -> None:
        for actor, weight in zip(self._actor(), weights, strict=True):
            actor.copy_(weight)

"""Exponential moving average of an actor's weights, for a policy that is steadier than the one that is trained."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from parking_exp.algorithms.model_files import read_weights

ACTOR = "actor."  # of the actor's weights among those of the policy


class PolicyAverage:
    """Average of the weights of a model's actor over its gradient updates (Polyak & Juditsky, 1992).

    Args:
        model: a Stable-Baselines3 model with an actor.
        half_life: updates in which an old weight's share halves; None: no average, the actor as it is.
    """

    def __init__(self, model: OffPolicyAlgorithm, half_life: float | None) -> None:
        self.model, self.half_life = model, half_life
        self._names = [name for name, _ in model.policy.named_parameters() if name.startswith(ACTOR)]
        self._weights: list[torch.Tensor] = []
        self._updates = 0

    def update(self) -> None:
        """Take in the updates that the model has made since the last call."""
        if self.half_life is None or (new := self.model._n_updates - self._updates) <= 0:
            return
        actor = self._actor()
        if self._weights:
            torch._foreach_lerp_(self._weights, actor, 1 - 0.5 ** (new / self.half_life))
        else:
            self._weights = [weight.clone() for weight in actor]
        self._updates = self.model._n_updates

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Have the model's actor be the average, for a while."""
        self.update()
        if not self._weights:
            yield
            return
        actor = self._actor()
        trained = [weight.clone() for weight in actor]
        torch._foreach_copy_(actor, self._weights)
        try:
            yield
        finally:
            torch._foreach_copy_(actor, trained)

    def load(self, path: Path) -> None:
        """Restore the average from a model file that was saved while it was applied; the model is as it was then.

        Raises:
            DamagedModelError: the file can't be read.
        """
        if not self.model._n_updates:  # there was nothing to average yet
            return
        policy = read_weights(path.read_bytes(), str(path), self.model.device)["policy"]
        self._weights = [policy[name] for name in self._names]
        self._updates = self.model._n_updates

    def _actor(self) -> list[torch.Tensor]:
        parameters = dict(self.model.policy.named_parameters())
        return [parameters[name].data for name in self._names]

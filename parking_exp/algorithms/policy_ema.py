"""Exponential moving average (EMA) of an actor's weights, steadier than the trained actor."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm


class PolicyEMA:
    """Exponential moving average of the weights of a model's actor over its gradient updates.

    It begins with the weights after the first round of updates, and includes the statistics of
    batch normalisation.

    Args:
        model: a Stable-Baselines3 model with an actor.
        half_life: the half-life in gradient updates; None: no average, the actor as it is.
    """

    def __init__(self, model: OffPolicyAlgorithm, half_life: float | None) -> None:
        self.model = model
        self.half_life = half_life
        self._weights: list[torch.Tensor] = []
        self._updates = 0

    def update(self) -> None:
        """Include the updates that the model has made since the last call."""
        new = self.model._n_updates - self._updates
        if self.half_life is None or new <= 0:
            return
        if not self._weights:
            self._weights = [weight.clone() for weight in self._actor()]
        for average, trained in zip(self._weights, self._actor(), strict=True):
            average.lerp_(trained, 1 - 0.5 ** (new / self.half_life))
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

    def get_state(self) -> list[np.ndarray]:
        """Return the averaged weights; none before the first update."""
        self.update()
        return [weight.cpu().numpy() for weight in self._weights]

    def set_state(self, weights: Sequence[np.ndarray]) -> None:
        """Restore the average. The model has to be restored before."""
        self._weights = [torch.as_tensor(weight, device=self.model.device) for weight in weights]
        self._updates = self.model._n_updates

    def _actor(self) -> list[torch.Tensor]:
        weights = self.model.policy.get_submodule("actor").state_dict().values()
        return [weight for weight in weights if weight.is_floating_point()]

    def _set_actor(self, weights: Sequence[torch.Tensor]) -> None:
        for actor, weight in zip(self._actor(), weights, strict=True):
            actor.copy_(weight)

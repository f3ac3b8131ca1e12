"""Mixin that gives SAC, TD3 and DDPG a faster `train`: when it applies, and what it logs."""

from typing import Any, ClassVar, Protocol

import torch

from parking_exp.algorithms.fast.supported import is_supported


class Update(Protocol):
    """The update of one model's networks, without autograd."""

    def __init__(self, model: Any) -> None: ...

    def is_bound(self, model: Any) -> bool:
        """Whether the networks and optimizers are still the model's."""

    def run(self, model: Any, gradient_steps: int, batch_size: int) -> dict[str, float]:
        """Do `gradient_steps` updates and return the means of what Stable-Baselines3 logs."""


class FastTraining:
    """Mixin that replaces the `train` of an off-policy class of Stable-Baselines3; it stands before that class.

    Models that the fast update does not support (`supported.is_supported`) are trained by Stable-Baselines3's `train`.
    """

    update_class: ClassVar[type[Update]]
    _update: Update | None = None

    def train(self: Any, gradient_steps: int, batch_size: int = 64) -> None:
        """Do `gradient_steps` updates on minibatches of the replay buffer."""
        if not is_supported(self):
            super().train(gradient_steps, batch_size)  # type: ignore[misc]
            return
        optimizers = [self.actor.optimizer, self.critic.optimizer, getattr(self, "ent_coef_optimizer", None)]
        self._update_learning_rate([optimizer for optimizer in optimizers if optimizer is not None])
        self.bind()
        with torch.inference_mode():  # a tenth faster than no_grad: most operations here are tiny
            losses = self._update.run(self, gradient_steps, batch_size)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        for name, value in losses.items():
            self.logger.record(f"train/{name}", value)

    def bind(self: Any) -> None:
        """Flatten the memory of networks and optimizers as the update needs it, unless it is already.

        `train` calls this. Restoring a model calls it too: weights elsewhere in memory may round differently.
        """
        if is_supported(self) and (self._update is None or not self._update.is_bound(self)):
            with torch.no_grad():
                self._update = self.update_class(self)

    def _excluded_save_params(self: Any) -> list[str]:
        return [*super()._excluded_save_params(), "_update"]  # type: ignore[misc]

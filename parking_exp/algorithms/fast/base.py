"""What the lean SAC, TD3 and DDPG share: when to update by hand, and what is logged."""

from typing import Any, ClassVar, Protocol

import torch

from parking_exp.algorithms.fast.support import is_lean


class Update(Protocol):
    """The update of one model's networks, written out."""

    def __init__(self, model: Any) -> None: ...

    def is_bound(self, model: Any) -> bool:
        """Whether the networks and optimizers are still the model's."""

    def run(self, model: Any, gradient_steps: int, batch_size: int) -> dict[str, float]:
        """Do the updates of a round and return the means of what Stable-Baselines3 logs."""


class LeanTraining:
    """Goes before an off-policy class of Stable-Baselines3 among a class's bases, and replaces its `train`.

    What the lean update does not know (`support.is_lean`) is trained by Stable-Baselines3's own.
    """

    update_class: ClassVar[type[Update]]
    _update: Update | None = None

    def train(self: Any, gradient_steps: int, batch_size: int = 64) -> None:
        """Do the updates of one round."""
        if not is_lean(self):
            super().train(gradient_steps, batch_size)  # type: ignore[misc]
            return
        optimizers = [self.actor.optimizer, self.critic.optimizer, getattr(self, "ent_coef_optimizer", None)]
        self._update_learning_rate([optimizer for optimizer in optimizers if optimizer is not None])
        self.bind()
        with torch.no_grad():
            losses = self._update.run(self, gradient_steps, batch_size)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        for name, value in losses.items():
            self.logger.record(f"train/{name}", value)

    def bind(self: Any) -> None:
        """Lay networks and optimizers out in memory as the update wants them, unless they are.

        `train` does so by itself. Weights that were loaded elsewhere in memory may round otherwise until then.
        """
        if is_lean(self) and (self._update is None or not self._update.is_bound(self)):
            with torch.no_grad():
                self._update = self.update_class(self)

    def _excluded_save_params(self: Any) -> list[str]:
        return [*super()._excluded_save_params(), "_update"]  # type: ignore[misc]

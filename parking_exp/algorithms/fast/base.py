"""Mixin that gives SAC, TD3 and DDPG a faster `train`: when it applies, and what it logs."""

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.noise import ActionNoise

from parking_exp.algorithms.fast.supported import is_supported


class FastTraining:
    """Mixin that replaces the `train` of an off-policy class of Stable-Baselines3; it stands before that class.

    Models that the fast update does not support (`supported.is_supported`) are trained by Stable-Baselines3's `train`.

    Attributes:
        update_class: the update of one model's networks, without autograd: SAC's or TD3's.
    """

    update_class: ClassVar[type]
    _update: Any = None

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

    def _sample_action(
        self: Any, learning_starts: int, action_noise: ActionNoise | None = None, n_envs: int = 1
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return actions for the envs and for the buffer, shape (n_envs, actions) each.

        The random ones of all envs are drawn at once: the same numbers as Stable-Baselines3's one by one.
        """
        space = self.action_space
        is_bounded = isinstance(space, gym.spaces.Box) and space.is_bounded() and space.dtype.kind == "f"
        if self.num_timesteps >= learning_starts or not is_bounded or getattr(self, "use_sde_at_warmup", False):
            return super()._sample_action(learning_starts, action_noise, n_envs)  # type: ignore[misc]
        random = space.np_random.uniform(space.low, space.high, (n_envs, *space.shape)).astype(space.dtype)
        scaled = self.policy.scale_action(random)
        if action_noise is not None:
            scaled = np.clip(scaled + action_noise(), -1, 1)
        return self.policy.unscale_action(scaled), scaled

    def _excluded_save_params(self: Any) -> list[str]:
        return [*super()._excluded_save_params(), "_update"]  # type: ignore[misc]

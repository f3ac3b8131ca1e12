"""Mixin that gives SAC, TD3 and DDPG a faster `train`, and which models it supports."""

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from stable_baselines3.common.torch_layers import CombinedExtractor, get_actor_critic_arch
from torch import nn

from parking_exp.algorithms.mirrored_policies import MIRRORED
from parking_exp.buffers import HerBuffer
from parking_exp.tasks.feature_extractors import TaskFeatures

POLICIES = {*MIRRORED, *MIRRORED.values()}
ADAM_ARGUMENTS = {"betas", "eps"}


class FastTraining:
    """Mixin that replaces the `train` of an off-policy class of Stable-Baselines3.

    List it before that class. Models that the fast update does not support (`is_supported`) are
    trained by Stable-Baselines3's `train`.

    Attributes:
        update_class: the update of one model's networks, without autograd: SAC's or TD3's.
    """

    update_class: ClassVar[type]
    _updater: Any = None
    _flat_addresses: Sequence[int] = ()

    def train(self: Any, gradient_steps: int, batch_size: int = 64) -> None:
        """Do `gradient_steps` updates on minibatches of the replay buffer."""
        self.flatten_parameters()
        if self._updater is None:
            super().train(gradient_steps, batch_size)  # type: ignore[misc]
            return
        self._update_learning_rate(self._optimizers())
        with torch.inference_mode():  # a tenth faster than no_grad: most operations here are tiny
            losses = self._updater.run(self, gradient_steps, batch_size)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        for name, value in losses.items():
            self.logger.record(f"train/{name}", value)

    def flatten_parameters(self: Any) -> None:
        """Lay the parameters and optimizer states out in flat vectors, unless they are already.

        `train` calls this. Restoring a model calls it too: weights elsewhere in memory may round
        differently.
        """
        if self._addresses() == self._flat_addresses:
            return
        with torch.no_grad():
            self._updater = self.update_class(self) if is_supported(self) else None
        self._flat_addresses = self._addresses()

    def _addresses(self: Any) -> list[int]:
        """Return where weights and optimizer states are.

        Loading, copying or moving a model replaces some of them.
        """
        tensors = list(self.policy.parameters())
        for optimizer in self._optimizers():
            tensors += [
                state["exp_avg"] for state in optimizer.state.values() if "exp_avg" in state
            ]
        return [tensor.data_ptr() for tensor in tensors]

    def _optimizers(self: Any) -> list[torch.optim.Optimizer]:
        optimizers = [self.actor.optimizer, self.critic.optimizer]
        if getattr(self, "ent_coef_optimizer", None) is not None:
            optimizers.append(self.ent_coef_optimizer)
        return optimizers

    def _excluded_save_params(self: Any) -> list[str]:
        excluded = super()._excluded_save_params()  # type: ignore[misc]
        return [*excluded, "_updater", "_flat_addresses"]


def is_supported(model: Any) -> bool:
    """Return whether the fast update supports a SAC, TD3 or DDPG model.

    It supports Stable-Baselines3's policies for Dict observations and this package's mirrored ones,
    MLPs with ReLU, features without parameters, plain Adam, `HerBuffer` and the CPU; not gSDE.
    """
    policy = model.policy
    extractor = policy.actor.features_extractor
    return (
        type(policy) in POLICIES
        and type(model.replay_buffer).sample is HerBuffer.sample
        and policy.activation_fn is nn.ReLU
        and all(get_actor_critic_arch(policy.net_arch))
        and policy.optimizer_class is torch.optim.Adam
        and ADAM_ARGUMENTS.issuperset(policy.optimizer_kwargs)
        and (type(extractor) is CombinedExtractor or isinstance(extractor, TaskFeatures))
        and next(extractor.parameters(), None) is None
        and not model.use_sde
        and model.device.type == "cpu"
    )

"""Mixin that gives SAC, TD3 and DDPG a faster `train`, and which models it supports."""

from collections.abc import Sequence
from typing import Any, ClassVar, cast

import torch
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import CombinedExtractor, FlattenExtractor
from stable_baselines3.sac.policies import Actor as GaussianActor
from stable_baselines3.td3.policies import Actor as DeterministicActor
from torch import nn

from parking_exp.algorithms.fast.mlp import linear_layers
from parking_exp.algorithms.fast.optimizer import is_plain_adam
from parking_exp.algorithms.mirrored_policies import (
    MirroredActor,
    MirroredCritic,
    MirroredGaussianActor,
)
from parking_exp.tasks.feature_extractors import TaskFeatures

EXTRACTORS = (CombinedExtractor, FlattenExtractor)


class FastTraining:
    """Mixin that replaces the `train` of an off-policy class of Stable-Baselines3; list it before
    that class.

    Models that the fast update does not support (`is_supported`) are trained by Stable-Baselines3's
    `train`.

    Attributes:
        update_class: the update of one model's networks, without autograd: SAC's or TD3's.
    """

    update_class: ClassVar[type]
    _update: Any = None
    _bound: Sequence[int] = ()

    def train(self: Any, gradient_steps: int, batch_size: int = 64) -> None:
        """Do `gradient_steps` updates on minibatches of the replay buffer."""
        self.bind()
        if self._update is None:
            super().train(gradient_steps, batch_size)  # type: ignore[misc]
            return
        self._update_learning_rate(self._optimizers())
        with torch.inference_mode():  # a tenth faster than no_grad: most operations here are tiny
            losses = self._update.run(self, gradient_steps, batch_size)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        for name, value in losses.items():
            self.logger.record(f"train/{name}", value)

    def bind(self: Any) -> None:
        """Flatten the memory of networks and optimizers as the update needs it, unless it is
        already.

        Whether the model is supported is checked at the same time: when it is new, or its weights
        were replaced.

        `train` calls this. Restoring a model calls it too: weights elsewhere in memory may round
        differently.
        """
        if self._addresses() == self._bound:
            return
        with torch.no_grad():
            self._update = self.update_class(self) if is_supported(self) else None
        self._bound = self._addresses()

    def _addresses(self: Any) -> list[int]:
        """Return where weights and optimizer states are: loading, copying or moving a model
        replaces some of them.
        """
        states = [state for optimizer in self._optimizers() for state in optimizer.state.values()]
        averages = [
            state["exp_avg"] for state in states if "exp_avg" in state
        ]  # replaced together with the others
        return [tensor.data_ptr() for tensor in (*self.policy.parameters(), *averages)]

    def _optimizers(self: Any) -> list[torch.optim.Optimizer]:
        optimizers = (
            self.actor.optimizer,
            self.critic.optimizer,
            getattr(self, "ent_coef_optimizer", None),
        )
        return [optimizer for optimizer in optimizers if optimizer is not None]

    def _excluded_save_params(self: Any) -> list[str]:
        return [*super()._excluded_save_params(), "_update", "_bound"]  # type: ignore[misc]


def is_supported(model: Any) -> bool:
    """Return whether the fast update supports everything in a SAC, TD3 or DDPG model.

    It supports Stable-Baselines3's own actors and critics and this package's mirrored ones, MLPs
    with ReLU, features without parameters, plain Adam and the CPU; not gSDE.
    """
    actor, critic = model.actor, model.critic
    mirrored = type(critic) is MirroredCritic
    if not (mirrored or type(critic) is ContinuousCritic) or getattr(model, "use_sde", False):
        return False
    if type(actor) is (MirroredGaussianActor if mirrored else GaussianActor):
        known = (
            linear_layers(actor.latent_pi) and type(actor.mu) is type(actor.log_std) is nn.Linear
        )
    else:
        deterministic = type(actor) is (MirroredActor if mirrored else DeterministicActor)
        known = deterministic and linear_layers(actor.mu, last=nn.Tanh)
    ent_coef_optimizer = getattr(model, "ent_coef_optimizer", None)
    return bool(
        known
        and all(linear_layers(cast(nn.Sequential, network)) for network in critic.q_networks)
        and all(_is_known(network.features_extractor) for network in (actor, critic))
        and type(actor.features_extractor) is type(critic.features_extractor)
        and all(_is_fully_trained(network) for network in (actor, critic))
        and (ent_coef_optimizer is None or is_plain_adam(ent_coef_optimizer))
    )


def _is_known(extractor: Any) -> bool:
    return isinstance(extractor, TaskFeatures) or type(extractor) in EXTRACTORS


def _is_fully_trained(network: Any) -> bool:
    """Return whether plain Adam trains all of a network's parameters, and its features extractor
    has none.
    """
    if (
        not is_plain_adam(network.optimizer)
        or next(network.features_extractor.parameters(), None) is not None
    ):
        return False
    (group,) = network.optimizer.param_groups
    return {id(tensor) for tensor in group["params"]} == {
        id(tensor) for tensor in network.parameters()
    }

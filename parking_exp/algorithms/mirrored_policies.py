"""Policies of SAC and TD3 whose networks see one of two mirror images of a task.

The env's actions are not mirrored: an actor's output is mirrored after its network, a critic's
action before it.
"""

from typing import Any

import torch
from stable_baselines3.common.policies import ContinuousCritic
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac import policies as sac
from stable_baselines3.td3 import policies as td3
from torch import nn

from parking_exp.tasks.feature_extractors import SymmetricFeatures


class MirroredActor(td3.Actor):
    """TD3's actor, mirrored."""

    features_extractor: SymmetricFeatures

    def forward(self, obs: Any) -> torch.Tensor:
        """Return actions, shape (batch, actions)."""
        return self.features_extractor.mirror(super().forward(obs), obs)


class MirroredGaussianActor(sac.Actor):
    """SAC's actor, mirrored."""

    features_extractor: SymmetricFeatures

    def forward(self, obs: Any, deterministic: bool = False) -> torch.Tensor:
        """Return actions, shape (batch, actions)."""
        return self.features_extractor.mirror(super().forward(obs, deterministic), obs)

    def action_log_prob(self, obs: Any) -> tuple[torch.Tensor, torch.Tensor]:
        """Return sampled actions, shape (batch, actions), and their log probabilities."""
        actions, log_prob = super().action_log_prob(obs)
        return self.features_extractor.mirror(actions, obs), log_prob


class MirroredCritic(ContinuousCritic):
    """Q-networks, mirrored."""

    features_extractor: SymmetricFeatures

    def forward(self, obs: Any, actions: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return each network's values, shape (batch, 1)."""
        return super().forward(obs, self.features_extractor.mirror(actions, obs))

    def q1_forward(self, obs: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the first network's values, shape (batch, 1)."""
        return super().q1_forward(obs, self.features_extractor.mirror(actions, obs))


class _MirroredPolicy:
    """Mixin of policies: their actors and critics are mirrored."""

    actor_class: type[nn.Module]

    def make_actor(self: Any, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        arguments = self._update_features_extractor(self.actor_kwargs, features_extractor)
        return self.actor_class(**arguments).to(self.device)

    def make_critic(self: Any, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        arguments = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return MirroredCritic(**arguments).to(self.device)


class MirroredTD3Policy(_MirroredPolicy, td3.MultiInputPolicy):
    """TD3's and DDPG's policy for Dict observations, mirrored."""

    actor_class = MirroredActor


class MirroredSACPolicy(_MirroredPolicy, sac.MultiInputPolicy):
    """SAC's policy for Dict observations, mirrored."""

    actor_class = MirroredGaussianActor


MIRRORED: dict[type | None, type] = {
    td3.MultiInputPolicy: MirroredTD3Policy,
    sac.MultiInputPolicy: MirroredSACPolicy,
}
"""Policies of Stable-Baselines3 and what replaces them."""

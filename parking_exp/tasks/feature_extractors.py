"""Base classes of the features that tasks compute from goal observations."""

from abc import ABC, abstractmethod

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor


class TaskFeatures(BaseFeaturesExtractor):
    """Features without parameters, which depend on the observation of a transition alone.

    They are computed inside the policy, so goals that HER relabels pass through them like any
    other.
    """


class SymmetricFeatures(TaskFeatures, ABC):
    """Features of a task with a mirror symmetry: networks see one of two mirror images.

    The policies of `algorithms.mirrored_policies` mirror actions accordingly.
    """

    @abstractmethod
    def mirror(self, actions: torch.Tensor, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return actions, (batch, actions), some negated where the observation is mirrored."""

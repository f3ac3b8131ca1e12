"""Scale observations and goals by their means and standard deviations, inside the policy.

Achieved and desired goals share one set of statistics, as in OpenAI Baselines, the HER paper's
implementation. So virtual goals are scaled like real goals. Stable-Baselines3's `VecNormalize` has
separate statistics for both. It scales an achieved goal differently once HER makes it a desired
goal.
"""

from collections.abc import Mapping

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from parking_exp.tasks.feature_extractors import TaskFeatures

MIN_STD = 1e-2
CLIP = 5.0  # standard deviations, as in the paper's implementation
KINDS = {"observation": "observation", "achieved_goal": "goal", "desired_goal": "goal"}


class Normalizer(nn.Module):
    """Means and standard deviations of what the training envs have shown.

    They are saved with the policy.

    Attributes:
        kinds: entries of an observation, and the names of their statistics.
    """

    def __init__(self, space: spaces.Dict) -> None:
        super().__init__()
        others = [key for key in space.spaces if key not in KINDS]
        self.kinds = KINDS | {key: f"entry_{number}" for number, key in enumerate(others)}
        for key, kind in self.kinds.items():
            size = spaces.flatdim(space[key])
            self.register_buffer(f"{kind}_sum", torch.zeros(size, dtype=torch.float64))
            self.register_buffer(f"{kind}_squares", torch.zeros(size, dtype=torch.float64))
            self.register_buffer(f"{kind}_count", torch.zeros((), dtype=torch.float64))

    def update(self, observations: Mapping[str, np.ndarray]) -> None:
        """Add observations, each entry of shape (n, ...)."""
        for key, kind in self.kinds.items():
            count, total, squares = self._statistics(kind)
            values = torch.as_tensor(observations[key], dtype=torch.float64, device=count.device)
            values = values.flatten(1)
            count.add_(len(values))
            total.add_(values.sum(0))
            squares.add_((values**2).sum(0))

    def forward(self, key: str, values: torch.Tensor) -> torch.Tensor:
        """Return an entry, shape (batch, size), in standard deviations from the mean.

        It is unscaled before any update.
        """
        count, total, squares = self._statistics(self.kinds[key])
        known = torch.clamp(count, min=1.0)
        mean = total / known
        deviation = torch.sqrt(torch.clamp(squares / known - mean**2, min=MIN_STD**2))
        deviation = torch.where(count > 0, deviation, torch.ones_like(deviation))
        return ((values - mean) / deviation).clamp(-CLIP, CLIP).float()

    def _statistics(self, kind: str) -> list[torch.Tensor]:
        return [self.get_buffer(f"{kind}_{name}") for name in ("count", "sum", "squares")]


class NormalizedExtractor(TaskFeatures):
    """Observation, achieved and desired goal, and further entries of the observation, normalised.

    Args:
        observation_space: the observation space of a goal environment.
        normalizer: the normalizer that is shared by all networks of a policy.
    """

    def __init__(self, observation_space: spaces.Dict, normalizer: Normalizer) -> None:
        super().__init__(observation_space, spaces.flatdim(observation_space))
        self.normalizer = normalizer

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features of shape (batch, size of all entries)."""
        entries = []
        for key in self.normalizer.kinds:
            entries.append(self.normalizer(key, observations[key].flatten(1)))
        return torch.cat(entries, dim=1)


class UpdateNormalizer(BaseCallback):
    """Add each step of the training envs to the statistics of a model's normalizer, if any."""

    def _on_step(self) -> bool:
        extractor = getattr(self.model.policy.actor, "features_extractor", None)
        if isinstance(extractor, NormalizedExtractor):
            extractor.normalizer.update(self.locals["new_obs"])
        return True

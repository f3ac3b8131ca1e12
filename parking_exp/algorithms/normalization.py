"""Scale observations and goals by their means and standard deviations, inside the policy.

One set of statistics serves achieved and desired goals, as in OpenAI Baselines, the HER paper's
implementation: virtual goals pass through the same scaling as real ones. Stable-Baselines3's
`VecNormalize` has one for each entry, and scales a goal that HER moves from one to the other in two
ways.
"""

from collections.abc import Mapping

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn

from parking_exp.tasks.feature_extractors import TaskFeatures

MIN_STD, CLIP = 1e-2, 5.0  # of the paper's implementation: clipped to five standard deviations
KINDS = {"observation": "observation", "achieved_goal": "goal", "desired_goal": "goal"}


def entry_kinds(space: spaces.Dict) -> dict[str, str]:
    """Return the entries of an observation and the names of their statistics, further entries
    last.
    """
    others = [key for key in space.spaces if key not in KINDS]
    return {**KINDS, **{key: f"entry_{number}" for number, key in enumerate(others)}}


class Normalizer(nn.Module):
    """Means and standard deviations of what the training envs have shown; saved with the policy
    that has it.
    """

    def __init__(self, space: spaces.Dict) -> None:
        super().__init__()
        self.kinds = entry_kinds(space)
        for key, kind in self.kinds.items():
            size = spaces.flatdim(space[key])
            for name in ("sum", "squares"):
                self.register_buffer(f"{kind}_{name}", torch.zeros(size, dtype=torch.float64))
            self.register_buffer(f"{kind}_count", torch.zeros((), dtype=torch.float64))

    def update(self, observations: Mapping[str, np.ndarray]) -> None:
        """Add observations, each entry of shape (n, ...)."""
        for key, kind in self.kinds.items():
            count = self.get_buffer(f"{kind}_count")
            values = torch.as_tensor(
                observations[key], dtype=torch.float64, device=count.device
            ).flatten(1)
            count.add_(len(values))
            self.get_buffer(f"{kind}_sum").add_(values.sum(0))
            self.get_buffer(f"{kind}_squares").add_((values**2).sum(0))

    def forward(self, key: str, values: torch.Tensor) -> torch.Tensor:
        """Return an entry, shape (batch, size), in standard deviations from the mean; unscaled
        before any update.
        """
        kind = self.kinds[key]
        count, total, squares = (
            self.get_buffer(f"{kind}_{name}") for name in ("count", "sum", "squares")
        )
        known = torch.clamp(count, min=1.0)
        mean = total / known
        deviation = torch.sqrt(torch.clamp(squares / known - mean**2, min=MIN_STD**2))
        deviation = torch.where(count > 0, deviation, torch.ones_like(deviation))
        return ((values - mean) / deviation).clamp(-CLIP, CLIP).float()


class NormalizedExtractor(TaskFeatures):
    """Observation, achieved and desired goal, and further entries of the observation, normalised.

    Args:
        observation_space: of a goal environment.
        normalizer: shared by all networks of a policy.
    """

    def __init__(self, observation_space: spaces.Dict, normalizer: Normalizer) -> None:
        super().__init__(
            observation_space,
            sum(spaces.flatdim(observation_space[key]) for key in normalizer.kinds),
        )
        self.normalizer = normalizer

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features of shape (batch, size of all entries)."""
        return torch.cat(
            [self.normalizer(key, observations[key].flatten(1)) for key in self.normalizer.kinds],
            dim=1,
        )


class UpdateNormalizer(BaseCallback):
    """Add each step of the training envs to the statistics of a model's normalizer, if it has
    one.
    """

    def _on_step(self) -> bool:
        extractor = getattr(self.model.policy.actor, "features_extractor", None)
        if isinstance(extractor, NormalizedExtractor):
            extractor.normalizer.update(self.locals["new_obs"])
        return True

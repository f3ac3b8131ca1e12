"""CrossQ for goal (Dict) observations."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import sb3_contrib
import torch
from sb3_contrib.crossq.policies import CrossQPolicy
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.torch_layers import CombinedExtractor


class ObservationBatch(dict[str, torch.Tensor]):
    """A Dict observation batch that `torch.cat` can join, entry by entry."""

    @classmethod
    def __torch_function__(
        cls,
        function: Callable[..., Any],
        types: Sequence[type],
        args: tuple = (),
        kwargs: Mapping | None = None,
    ) -> "ObservationBatch":
        """Handle `torch.cat([batch, ...])`, and nothing else."""
        if function is not torch.cat:
            return NotImplemented
        batches, *rest = args
        joined = cls()
        for key in batches[0]:
            joined[key] = torch.cat([batch[key] for batch in batches], *rest, **(kwargs or {}))
        return joined


class MultiInputPolicy(CrossQPolicy):
    """CrossQ's policy for Dict observations."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        kwargs.setdefault("features_extractor_class", CombinedExtractor)
        super().__init__(*args, **kwargs)


class CrossQ(sb3_contrib.CrossQ):
    """sb3_contrib's CrossQ with a MultiInputPolicy, so that it learns from goal observations.

    Upstream joins the observations of a batch with `torch.cat`, which refuses dicts, and has no
    MultiInputPolicy. Its arithmetic is unchanged: here batches are dicts that can be joined.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        **sb3_contrib.CrossQ.policy_aliases,
        "MultiInputPolicy": MultiInputPolicy,
    }

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Do `gradient_steps` updates on minibatches of the replay buffer."""
        buffer: Any = self.replay_buffer
        sample = buffer.sample

        def joinable(*args: Any, **kwargs: Any) -> Any:
            data = sample(*args, **kwargs)
            return data._replace(
                observations=ObservationBatch(data.observations),
                next_observations=ObservationBatch(data.next_observations),
            )

        buffer.sample = joinable
        try:
            super().train(gradient_steps, batch_size)
        finally:
            del buffer.sample  # the class's own method is visible again

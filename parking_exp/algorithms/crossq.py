"""CrossQ for goal (Dict) observations."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar

import sb3_contrib
import torch
from sb3_contrib.crossq.policies import CrossQPolicy
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.policies import BasePolicy


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
        batches = args[0]
        return cls(
            {
                key: torch.cat([batch[key] for batch in batches], *args[1:], **(kwargs or {}))
                for key in batches[0]
            }
        )


class CrossQ(sb3_contrib.CrossQ):
    """sb3_contrib's CrossQ with a MultiInputPolicy, so that it learns from goal observations, with
    HER or without.

    Upstream joins observations of a batch with `torch.cat`, which refuses dicts, and does not
    implement
    MultiInputPolicy. Its arithmetic is unchanged: here batches are dicts that can be joined.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        **sb3_contrib.CrossQ.policy_aliases,
        "MultiInputPolicy": CrossQPolicy,
    }

    def train(self, gradient_steps: int, batch_size: int = 64) -> None:
        """Do `gradient_steps` updates on minibatches of the replay buffer."""
        assert self.replay_buffer is not None
        with _joinable_samples(self.replay_buffer):
            super().train(gradient_steps, batch_size)


@contextmanager
def _joinable_samples(buffer: ReplayBuffer) -> Iterator[None]:
    sample = buffer.sample

    def joinable(*args: Any, **kwargs: Any) -> Any:
        data: Any = sample(*args, **kwargs)
        observations, following = (
            ObservationBatch(data.observations),
            ObservationBatch(data.next_observations),
        )
        return data._replace(observations=observations, next_observations=following)

    buffer.sample = joinable  # type: ignore[method-assign]
    try:
        yield
    finally:
        del buffer.sample  # the class's own method is visible again

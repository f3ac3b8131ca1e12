"""Policies that are written by hand, or plan, and are not trained."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from parking_exp.tasks.task import Observation, Task


class ScriptedPolicy(ABC):
    """A policy that is not trained, and knows from which seeds its episodes start.

    `algorithm._target_` names a subclass, beside `trained: false`. Its other arguments are keys of
    the section, whose values are checked by their annotations, such as pydantic's `PositiveFloat`.

    Args:
        task: whose episodes it is for.
        seed: of its random numbers; that of the run.
    """

    def __init__(self, task: Task, seed: int) -> None:
        self.task = task
        self.seed = seed

    @classmethod
    def problems(cls, env: Any) -> Iterator[str]:
        """Yield a sentence for each reason why it can't act in the env of a config."""
        yield from ()

    @abstractmethod
    def start(self, seeds: Sequence[int], on_progress: Callable[[], None] | None = None) -> None:
        """Prepare for the episodes of a batch, which start now.

        Call `on_progress` now and then if this takes long; it may raise to stop.
        """

    @abstractmethod
    def __call__(self, observation: Observation) -> np.ndarray:
        """Return the actions of all episodes of the batch, shape (n, actions)."""

    @abstractmethod
    def keep(self, rows: np.ndarray) -> None:
        """Keep only some episodes of the batch, by mask; the others have ended."""

    def info(self, row: int) -> Mapping[str, Any]:
        """Return entries of `Episode.info` for an episode that has just ended."""
        return {}

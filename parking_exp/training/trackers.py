"""Trackers of a user's own package, which get a run's metrics while it trains."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hydra.utils import instantiate

from parking_exp.config.schema import RunConfig
from parking_exp.errors import class_and_message
from parking_exp.terminal import say


class Tracker(ABC):
    """Base class of the classes that `tracking.trackers` names.

    Args:
        config: the run's config, as plain containers.
        run_dir: the run directory, absolute.
    """

    def __init__(self, config: dict[str, Any], run_dir: Path) -> None:
        self.config = config
        self.run_dir = run_dir

    @abstractmethod
    def log(self, step: int, metrics: dict[str, float]) -> None:
        """Record a row of metrics at an env step, as `metrics.jsonl` has it."""

    def finish(self, status: str) -> None:  # noqa: B027 not all trackers need it
        """End the record of a run, which is `done`, `failed` or `interrupted`."""


class RunTrackers:
    """The trackers of one run: one that raises is reported, and not called again."""

    def __init__(self, config: RunConfig) -> None:
        self._trackers: list[Tracker] = []
        for node in config.tracking.trackers or ():
            try:
                make = instantiate(node, _partial_=True, _convert_="all")
                tracker = make(config=config.plain(), run_dir=config.run_dir)
            except Exception as error:
                self._report(node["_target_"], error)
            else:
                self._trackers.append(tracker)

    def log(self, step: int, metrics: dict[str, float]) -> None:
        """Pass a row of metrics to each tracker."""
        self._call_each(lambda tracker: tracker.log(step, dict(metrics)))

    def finish(self, status: str) -> None:
        """Tell each tracker how the run has ended."""
        self._call_each(lambda tracker: tracker.finish(status))

    def _call_each(self, call: Callable[[Tracker], None]) -> None:
        for tracker in [*self._trackers]:
            try:
                call(tracker)
            except Exception as error:
                self._trackers.remove(tracker)
                self._report(f"{type(tracker).__module__}.{type(tracker).__name__}", error)

    def _report(self, name: str, error: Exception) -> None:
        say(
            f"the tracker {name} failed ({class_and_message(error)}); the run goes on without it",
            stderr=True,
        )

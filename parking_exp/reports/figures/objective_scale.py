"""The axis of an objective of a search."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from parking_exp.reports.tuning_data import Objective


class ObjectiveScale:
    """How values of an objective are drawn: rates in %, costs as they are, trials whose seeds missed 95 % beyond them.

    Attributes:
        low, high: ends of the axis.
        beyond: where trials are drawn that missed 95 % on some seed; None where there are none.
    """

    def __init__(self, objective: Objective, values: Sequence[float]) -> None:
        self.objective = objective
        known = [self._plain(value) for value in values if not objective.missed(value)]
        low, high = (min(known), max(known)) if known else (0.0, 1.0)
        least = 2.0 if objective.is_rate else 0.1 * abs(high)
        if high - low < least:
            low, high = max(0.0, low - least / 2), high + least / 2
        span = high - low
        self.beyond = high + 0.18 * span if len(known) < len(values) else None
        self.known_until = min(high + 0.06 * span, 100.0 if objective.is_rate else np.inf) if known else -np.inf
        self.low, self.high = low - 0.08 * span, (self.beyond or high) + 0.08 * span

    def _plain(self, value: float) -> float:
        return 100 * value if self.objective.is_rate else value

    def at(self, value: float) -> float:
        """Return where a value is drawn."""
        return self.beyond if self.beyond is not None and self.objective.missed(value) else self._plain(value)

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.objective.name} ({'%' if self.objective.is_rate else 'CPU-s'})"

    def fit(self, axes: Any, axis: str = "y", room: float = 0.0) -> None:
        """Set limits, ticks and label of an axis, with some room at the worse end, as a share of its length."""
        more = room * (self.high - self.low)
        ends = (self.low - more, self.high) if self.objective.higher_is_better else (self.low, self.high + more)
        axes.set(**{f"{axis}lim": ends})
        self.ticks(axes, axis)
        axes.set(**{f"{axis}label": self.label})

    def ticks(self, axes: Any, axis: str) -> None:
        """Set the ticks of an axis whose limits are set."""
        found = [t for t in getattr(axes, f"get_{axis}ticks")() if max(0.0, self.low) <= t <= self.known_until]
        texts = [f"{tick:.6g}" for tick in found]
        if self.beyond is not None:
            found, texts = [*found, self.beyond], [*texts, "missed"]
        getattr(axes, f"set_{axis}ticks")(found, texts)

    def height(self, value: float) -> float:
        """Return where a value stands between the worst, 0, and the best, 1."""
        share = (self.at(value) - self.low) / (self.high - self.low)
        return share if self.objective.higher_is_better else 1 - share

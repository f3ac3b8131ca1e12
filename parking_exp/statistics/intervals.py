"""Numbers with confidence intervals, and when an interval covers less than it says."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

GAP = 0.3  # between neighbouring seeds: rare without a collapse, nearly certain with one
COLLAPSED_COVERS = ((10, 40), (20, 63), (30, 87))  # below so many seeds, percent; 95 from 30


@dataclass(frozen=True)
class Interval:
    """A number with its confidence interval.

    Attributes:
        value: e.g. the mean over seeds; None without data.
        low, high: None where the data allow for no interval, e.g. over one seed.
        n: seeds behind it; behind a difference, those of the side that has fewer.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    n: int = 0

    @property
    def excludes_0(self) -> bool:
        """Whether 0 lies outside, of an interval that has ends."""
        return self.low is not None and self.high is not None and not self.low <= 0 <= self.high


def coverage_note(values: ArrayLike) -> str | None:
    """Return a sentence where intervals of such seeds cover too little, or None.

    `values`, shape (seeds,), are rates in 0 ... 1. Too little is less than 93 % in simulation. The
    percentages are those of `tests/support/coverage_simulation.py`. Collapses that no seed shows go
    unnoticed (see `unseen_share`).
    """
    n = np.size(values)
    gap = np.diff(np.sort(values)).max(initial=0)
    covered = [percent for n_seeds, percent in COLLAPSED_COVERS if n < n_seeds]
    if gap <= GAP or not covered:
        return None
    return (
        f"The {n} seeds fall into two groups, {100 * gap:.0f} points apart, so the interval may be "
        "too narrow: in simulations where one seed in ten collapses, such intervals covered "
        f"{covered[0]} % instead of 95."
    )

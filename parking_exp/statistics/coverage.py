"""Warn where an interval's real coverage is below its nominal level."""

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.errors import plural
from parking_exp.statistics.rates import finite

FEWEST_SEEDS = 5
GAP = 0.3  # between neighbouring seeds: rare without a collapse, nearly certain with one
COLLAPSED_COVERS = ((10, 62), (20, 66), (30, 86))  # below so many seeds, percent; 95 from 30
IMBALANCE = 4.0  # ratio of the squared errors of two means
CEILING = 0.97


def coverage_note(values: ArrayLike, other: ArrayLike | None = None) -> str | None:
    """Return a sentence where seeds look like those whose 95 % interval covered less than 93 % in simulation, or None.

    `values`, shape (seeds,), are rates in 0 ... 1. With a second cell's, `other`, the note is also about Welch's
    interval of their difference. The percentages are those of `tests/support/coverage_simulation.py`. Collapses that no
    seed shows go unnoticed (see `unseen_share`).

    Raises:
        ValueError: a side is empty or holds NaN.
    """
    sides = [finite(side, "a note on coverage") for side in ((values,) if other is None else (values, other))]
    fewest = min(len(side) for side in sides)
    if fewest < FEWEST_SEEDS:
        return (
            f"{plural(fewest, 'seed')}: too few for a reliable interval; with fewer than {FEWEST_SEEDS}, "
            "95 % intervals covered 89 % where rates scatter widely below the ceiling, and 59 % where one in ten "
            "collapses."
        )
    for side in sides:
        gap = float(np.diff(np.sort(side)).max())
        covered = next((percent for below, percent in COLLAPSED_COVERS if len(side) < below), None)
        if gap > GAP and covered is not None:
            return (
                f"The {len(side)} seeds fall into two groups, {100 * gap:.0f} points apart: where one seed in ten "
                f"collapses, 95 % intervals from about as many covered {covered} %."
            )
    if len(sides) == 2:
        squares = [side.var(ddof=1) / len(side) for side in sides]
        noisy = sides[int(squares[1] > squares[0])]
        if max(squares) > IMBALANCE * min(squares) and noisy.max() > CEILING and len(noisy) <= 30:
            return (
                "The noisier cell decides this difference and reaches the ceiling, with a tail below it: in such pairs "
                "Welch's 95 % interval covered as little as 74 % with 5 seeds, 81 % with 10 and 87 % with 20."
            )
    return None

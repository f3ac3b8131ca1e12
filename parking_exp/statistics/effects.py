"""Main effects and contrasts of crossed factors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import stdtr, stdtrit

from parking_exp.statistics.comparisons import Difference
from parking_exp.statistics.intervals import Interval

if TYPE_CHECKING:  # a training imports this package, but not pandas
    from collections.abc import Mapping, Sequence

    import pandas as pd

    Cells = Mapping[tuple[Any, ...], np.ndarray]  # levels of the factors -> responses


@dataclass(frozen=True)
class Level:
    """A level's mean over the levels of the other factors, all cells with equal weight."""

    level: Any
    effect: Interval
    cells: int


@dataclass(frozen=True)
class MainEffect:
    """What one factor does on average over the others.

    Attributes:
        factor: its name.
        levels: the mean of each.
        complete: whether all combinations are there; else levels are averaged over different cells.
        largest: the highest mean minus the lowest; None with a single level.
        p: of that difference, corrected (Bonferroni) for the choice among all pairs of levels.
    """

    factor: str
    levels: Sequence[Level]
    complete: bool
    largest: Interval | None = None
    p: float | None = None


def main_effects(frame: pd.DataFrame, factors: Sequence[str], response: str) -> list[MainEffect]:
    """Return the mean of cell means for every level of every factor; `frame` has a row per seed.

    Cells have equal weights. The response is a rate in 0 ... 1. The interval is that of a linear contrast of
    independent means with their own variances (Welch 1947; Satterthwaite 1946 for the degrees of freedom), clipped to
    0 ... 1. There is no interval if a cell of the level has a single seed or all values are equal.
    """
    cells = _cells(frame, factors, response)
    levels = [_levels(cells, place) for place in range(len(factors))]
    complete = len(cells) == math.prod(map(len, levels))
    effects = []
    for place, factor in enumerate(factors):
        own = {level: [values for key, values in cells.items() if key[place] == level] for level in levels[place]}
        effects.append(_main_effect(factor, own, complete))
    return effects


def _main_effect(name: str, own: Mapping[Any, Sequence[np.ndarray]], complete: bool) -> MainEffect:
    means = {level: _contrast(values, []) for level, values in own.items()}
    levels = [Level(level, mean.clipped(0, 1), len(own[level])) for level, mean in means.items()]
    if len(levels) < 2:
        return MainEffect(name, levels, complete)
    highest, lowest = (choose(means, key=lambda level: means[level].value or 0.0) for choose in (max, min))
    largest = _contrast(own[highest], own[lowest])
    p = None if largest.p is None else min(1.0, largest.p * math.comb(len(levels), 2))
    return MainEffect(name, levels, complete, largest.clipped(-1, 1), p)


def _contrast(side: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> Difference:
    """Return the mean of cell means of one side minus that of the other, which may be empty."""
    weights = np.array([1 / len(side) for _ in side] + [-1 / len(other) for _ in other])
    both = [*side, *other]
    sizes = np.array([len(values) for values in both])
    difference = float(weights @ [values.mean() for values in both])
    n = min(sum(map(len, values)) for values in (side, other) if values)
    squares = weights**2 * [_variance(values) for values in both] / sizes
    if not (sizes.min() > 1 and squares.sum() > 0):
        return Difference(difference, n=n)
    df = float(squares.sum()) ** 2 / float((squares**2 / (sizes - 1)).sum())
    error = math.sqrt(squares.sum())
    half = float(stdtrit(df, 0.975)) * error
    p = 2 * float(stdtr(df, -abs(difference) / error))
    return Difference(difference, difference - half, difference + half, n, "cells' own variances", p, df)


def _variance(values: np.ndarray) -> float:
    """Return the variance between seeds, exactly 0 without scatter (numpy's is some 1e-32) and for a single seed."""
    return float(values.var(ddof=1)) if np.ptp(values) > 0 else 0.0


def _cells(frame: pd.DataFrame, factors: Sequence[str], response: str) -> Cells:
    """Return the responses of every combination of levels that is there."""
    return {key: values.to_numpy(float) for key, values in frame.groupby(list(factors), sort=False)[response]}


def _levels(cells: Cells, place: int) -> list[Any]:
    """Return the sorted levels of a factor, numbers before texts."""
    return sorted({key[place] for key in cells}, key=lambda level: (isinstance(level, str), level))

"""Main effects, contrasts and interactions of crossed factors. Frames have one row per seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import fdtrc, stdtr, stdtrit

from parking_exp.statistics.checks import finite_or_none
from parking_exp.statistics.comparisons import Difference
from parking_exp.statistics.intervals import Interval, mean_interval

if TYPE_CHECKING:  # a training imports this package and needs no frames of ours
    from collections.abc import Mapping, Sequence

    import pandas as pd

    Cells = Mapping[tuple[Any, ...], np.ndarray]  # levels of the factors -> responses

CELLS = "cells' own variances"
POOLED = "pooled variance"


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


@dataclass(frozen=True)
class InteractionCell:
    """One combination of two levels: its mean, and what is left of it beside the sum of two effects."""

    row: Any
    column: Any
    mean: Interval
    residual: float


@dataclass(frozen=True)
class InteractionTable:
    """The combinations that there are, row by row.

    `p` says how well a sum of two effects explains them all: None where seeds do not scatter or nothing is left.
    """

    rows: Sequence[Any]
    columns: Sequence[Any]
    cells: Sequence[InteractionCell]
    p: float | None


def main_effects(
    frame: pd.DataFrame, factors: Sequence[str], response: str, confidence: float = 0.95
) -> list[MainEffect]:
    """Return the mean of cell means for every level of every factor: cells weigh the same, whatever their seeds.

    The response is a rate in 0 ... 1. The interval is that of a linear contrast of independent means with their own
    variances (Welch 1947; Satterthwaite 1946 for the degrees of freedom), cut where rates end; where a cell of the
    level has a single seed, the pooled variance of all cells stands in for all; None if all values are equal.
    """
    cells = _cells(frame, factors, response)
    levels = [_levels(cells, place) for place in range(len(factors))]
    complete = len(cells) == math.prod(map(len, levels))
    effects = []
    for place, factor in enumerate(factors):
        own = {level: [values for key, values in cells.items() if key[place] == level] for level in levels[place]}
        effects.append(_main_effect(factor, own, cells, complete, confidence))
    return effects


def _main_effect(
    name: str, own: Mapping[Any, Sequence[np.ndarray]], cells: Cells, complete: bool, confidence: float
) -> MainEffect:
    means = {level: _contrast(values, [], cells, confidence) for level, values in own.items()}
    levels = [Level(level, mean.clipped(0, 1), len(own[level])) for level, mean in means.items()]
    if len(levels) < 2:
        return MainEffect(name, levels, complete)
    highest, lowest = (choose(means, key=lambda level: means[level].value or 0.0) for choose in (max, min))
    largest = _contrast(own[highest], own[lowest], cells, confidence)
    p = None if largest.p is None else min(1.0, largest.p * math.comb(len(levels), 2))
    return MainEffect(name, levels, complete, largest.clipped(-1, 1), p)


def contrast(
    frame: pd.DataFrame, factors: Sequence[str], response: str, levels: tuple[str, Any, Any], confidence: float = 0.95
) -> Difference:
    """Return how far two levels of a factor are apart: the difference of the means that `main_effects` gives.

    `levels` is (factor, level, other level). Interval and p are as described there, not cut, None without scatter.

    Raises:
        ValueError: there is no such level.
    """
    cells = _cells(frame, factors, response)
    factor, *two = levels
    place = list(factors).index(factor)
    side, other = ([values for key, values in cells.items() if key[place] == level] for level in two)
    if not (side and other):
        raise ValueError(f"{factor} has no level {two[1] if side else two[0]!r}")
    return _contrast(side, other, cells, confidence)


def interaction(
    frame: pd.DataFrame,
    row_factor: str,
    column_factor: str,
    response: str,
    confidence: float = 0.95,
    bounds: tuple[float, float] | None = (0.0, 1.0),
) -> InteractionTable:
    """Return the mean of every combination of two factors, by `mean_interval`, and what is left of it beside their sum.

    Other factors are averaged over. The residual is cell mean - row mean - column mean + grand mean, every cell
    weighing the same; in an incomplete design, what is left of the additive fit by least squares.

    Raises:
        ValueError: a response lies outside `bounds`.
    """
    cells = _cells(frame, (row_factor, column_factor), response)
    rows, columns = _levels(cells, 0), _levels(cells, 1)
    means = np.array([values.mean() for values in cells.values()])
    design = np.array([[row == r for r in rows] + [column == c for c in columns] for row, column in cells], dtype=float)
    residuals = means - design @ np.linalg.lstsq(design, means, rcond=None)[0]
    combinations = [
        InteractionCell(key[0], key[1], mean_interval(values, confidence, bounds=bounds), float(residual))
        for (key, values), residual in zip(cells.items(), residuals, strict=True)
    ]
    combinations.sort(key=lambda cell: (rows.index(cell.row), columns.index(cell.column)))
    return InteractionTable(rows, columns, combinations, finite_or_none(_interaction_p(cells, design)))


def _contrast(side: Sequence[np.ndarray], other: Sequence[np.ndarray], cells: Cells, confidence: float) -> Difference:
    """Return the mean of cell means of one side minus that of the other, which may be empty."""
    weights = np.array([1 / len(side) for _ in side] + [-1 / len(other) for _ in other])
    both = [*side, *other]
    sizes = np.array([len(values) for values in both])
    difference = float(weights @ [values.mean() for values in both])
    n = min(sum(map(len, values)) for values in (side, other) if values)
    if sizes.min() > 1:
        squares, method = weights**2 * [_variance(values) for values in both] / sizes, CELLS
        spread = float((squares**2 / (sizes - 1)).sum())
        df = float(squares.sum()) ** 2 / spread if spread > 0 else 0.0
    else:
        pooled, df = _pooled(cells)
        squares, method = weights**2 * pooled / sizes, POOLED
    if not (df > 0 and squares.sum() > 0):
        return Difference(difference, n=n)
    error = math.sqrt(squares.sum())
    half = float(stdtrit(df, 0.5 + confidence / 2)) * error
    p = 2 * float(stdtr(df, -abs(difference) / error))
    return Difference(difference, difference - half, difference + half, n, method, p, df)


def _variance(values: np.ndarray) -> float:
    """Return the variance between seeds, 0 where they are all the same: numpy's is some 1e-32 there."""
    return float(values.var(ddof=1)) if np.ptp(values) > 0 else 0.0


def _pooled(cells: Cells) -> tuple[float, float]:
    """Return the pooled variance of all cells with two seeds or more, and its degrees of freedom; NaN and 0 without."""
    several = [values for values in cells.values() if len(values) > 1]
    df = float(sum(len(values) - 1 for values in several))
    return (sum(_variance(values) * (len(values) - 1) for values in several) / df if df else math.nan), df


def _interaction_p(cells: Cells, design: np.ndarray) -> float:
    """Return the p of the ANOVA-type test of interaction (Brunner, Dette and Munk 1997).

    Cell means are tested against the sum of two effects, with cells' own variances; where a cell has a single seed,
    with the pooled one.
    """
    sizes = np.array([len(values) for values in cells.values()])
    means = np.array([values.mean() for values in cells.values()])
    beside = np.eye(len(cells)) - design @ np.linalg.pinv(design)  # projects means on what the sum leaves of them
    if np.trace(beside) < 0.5:  # a whole number but for rounding: its degrees of freedom
        return math.nan
    single, weights = sizes.min() < 2, beside.diagonal()
    pooled, left = _pooled(cells)
    variances = (pooled if single else np.array([_variance(values) for values in cells.values()])) / sizes
    expected = float(weights @ variances)
    if not expected > 0:
        return math.nan
    if not single:
        left = expected**2 / float((weights**2 * variances**2 / (sizes - 1)).sum())
    df = expected**2 / float(variances @ beside**2 @ variances)
    return float(fdtrc(df, left, means @ beside @ means / expected))


def _cells(frame: pd.DataFrame, factors: Sequence[str], response: str) -> dict[tuple[Any, ...], np.ndarray]:
    """Return the responses of every combination of levels that is there."""
    cells: dict[tuple[Any, ...], list[float]] = {}
    for *key, value in zip(*(frame[name].tolist() for name in (*factors, response)), strict=True):
        cells.setdefault(tuple(key), []).append(value)
    return {key: np.array(values, dtype=float) for key, values in cells.items()}


def _levels(cells: Cells, place: int) -> list[Any]:
    """Return the levels of a factor in order, numbers by size; those that can't be compared by their names."""
    levels = list(dict.fromkeys(key[place] for key in cells))
    try:
        return sorted(levels)
    except TypeError:
        return sorted(levels, key=str)

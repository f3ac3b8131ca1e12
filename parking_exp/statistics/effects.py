"""Main effects, contrasts and interactions of crossed factors. Frames have one row per seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import fdtrc, stdtr, stdtrit

from parking_exp.statistics.comparisons import Difference
from parking_exp.statistics.intervals import NONE, mean_interval

if TYPE_CHECKING:  # a training imports this package and needs no frames of ours
    from collections.abc import Mapping, Sequence

    import pandas as pd

    Cells = Mapping[tuple[Any, ...], np.ndarray]  # levels of the factors -> responses

CELLS = "cells' own variances"
POOLED = "pooled variance"


@dataclass(frozen=True)
class LevelMean:
    """The mean of cell means at one level of a factor."""

    factor: str
    level: Any
    mean: float
    low: float
    high: float
    cells: int
    seeds: int
    method: str


@dataclass(frozen=True)
class MainEffects:
    """Every level of every factor; `complete` says whether all combinations of levels are there."""

    levels: tuple[LevelMean, ...]
    mean: float
    complete: bool


@dataclass(frozen=True)
class InteractionCell:
    """One combination of two levels: its mean, and what is left of it beside the sum of two effects."""

    row: Any
    column: Any
    mean: float
    low: float
    high: float
    n: int
    method: str
    residual: float


@dataclass(frozen=True)
class InteractionTable:
    """The combinations that there are, row by row.

    `complete` says whether none is missing, and `p` how well a sum of two effects explains them all: NaN where seeds do
    not scatter or nothing is left to explain.
    """

    rows: tuple[Any, ...]
    columns: tuple[Any, ...]
    cells: tuple[InteractionCell, ...]
    complete: bool
    p: float


def main_effects(frame: pd.DataFrame, factors: Sequence[str], response: str, confidence: float = 0.95) -> MainEffects:
    """Return the mean of cell means for every level of every factor: cells weigh the same, whatever their seeds.

    The interval is that of a linear contrast of independent means with their own variances (Welch 1947; Satterthwaite
    1946 for the degrees of freedom); where a cell of the level has a single seed, the pooled variance of all cells
    stands in for all; where nothing scatters, there is none. It is not cut at 0 or 1. In an incomplete design the
    levels are averaged over different cells: `complete` is False and differences may be due to those.
    """
    cells = _cells(frame, factors, response)
    levels = []
    for place, factor in enumerate(factors):
        for level in _levels(cells, place):
            own = [values for key, values in cells.items() if key[place] == level]
            mean = _contrast(own, [], cells, confidence)
            n = sum(map(len, own))
            levels.append(LevelMean(factor, level, mean.difference, mean.low, mean.high, len(own), n, mean.method))
    complete = len(cells) == math.prod(len(_levels(cells, place)) for place in range(len(factors)))
    return MainEffects(tuple(levels), float(np.mean([values.mean() for values in cells.values()])), complete)


def contrast(
    frame: pd.DataFrame, factors: Sequence[str], response: str, levels: tuple[str, Any, Any], confidence: float = 0.95
) -> Difference:
    """Return how far two levels of a factor are apart: the difference of the means that `main_effects` gives.

    `levels` is (factor, level, other level). Interval and p are as described there, NaN without scatter.

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
    residuals = dict(zip(cells, means - design @ np.linalg.lstsq(design, means, rcond=None)[0], strict=True))
    found = []
    for row, column in sorted(cells, key=lambda key: (rows.index(key[0]), columns.index(key[1]))):
        mean = mean_interval(cells[row, column], confidence, bounds=bounds)
        residual = float(residuals[row, column])
        found.append(InteractionCell(row, column, mean.mean, mean.low, mean.high, mean.n, mean.method, residual))
    complete = len(found) == len(rows) * len(columns)
    return InteractionTable(tuple(rows), tuple(columns), tuple(found), complete, _interaction_p(cells, design))


def _contrast(side: Sequence[np.ndarray], other: Sequence[np.ndarray], cells: Cells, confidence: float) -> Difference:
    """Return the mean of cell means of one side minus that of the other, which may be empty."""
    weights = np.array([1 / len(side) for _ in side] + [-1 / len(other) for _ in other])
    both = [*side, *other]
    sizes = np.array([len(values) for values in both])
    difference = float(weights @ [values.mean() for values in both])
    n_side, n_other = sum(map(len, side)), sum(map(len, other))
    if sizes.min() > 1:
        squares, method = weights**2 * [_variance(values) for values in both] / sizes, CELLS
        spread = float((squares**2 / (sizes - 1)).sum())
        df = float(squares.sum()) ** 2 / spread if spread > 0 else 0.0
    else:
        pooled, df = _pooled(cells)
        squares, method = weights**2 * pooled / sizes, POOLED
    if not (df > 0 and squares.sum() > 0):
        return Difference(difference, math.nan, math.nan, math.nan, math.nan, n_side, n_other, NONE)
    error = math.sqrt(squares.sum())
    half = float(stdtrit(df, 0.5 + confidence / 2)) * error
    p = 2 * float(stdtr(df, -abs(difference) / error))
    return Difference(difference, difference - half, difference + half, p, df, n_side, n_other, method)


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

"""Main effects, contrasts and interactions of crossed factors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import fdtrc, stdtr, stdtrit

from parking_exp.statistics.checks import confident
from parking_exp.statistics.comparisons import Difference
from parking_exp.statistics.intervals import NONE, mean_interval

if TYPE_CHECKING:  # a training imports this package and needs no frames of ours
    from collections.abc import Mapping, Sequence

    import pandas as pd

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
    """One combination; where it is missing, `n` is 0 and the numbers are NaN."""

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
    """All combinations, row by row; `complete` says whether none is missing, and `p` how well a sum of two effects
    explains them all: NaN where seeds do not scatter or nothing is left to explain.
    """

    rows: tuple[Any, ...]
    columns: tuple[Any, ...]
    cells: tuple[InteractionCell, ...]
    complete: bool
    p: float


def main_effects(frame: pd.DataFrame, factors: Sequence[str], response: str, confidence: float = 0.95) -> MainEffects:
    """Return the mean of cell means for every level of every factor: cells weigh the same, however many seeds they
    have.

    `frame` has one row per seed. The interval is that of a linear contrast of independent means with their own
    variances (Welch 1947; Satterthwaite 1946 for the degrees of freedom); where a cell of the level has a single
    seed, the pooled variance of all cells stands in for all; where nothing scatters, there is none. It is not cut at
    0 or 1. In an incomplete design the levels are averaged over different cells: `complete` is False and differences
    may be due to those.

    Raises:
        ValueError: a column is missing, there are no rows or factors, or the response or a factor holds NaN.
    """
    _check(frame, factors, response)
    confident(confidence)
    groups = dict(_cells(frame, factors, response))
    variance, df = _pooled(list(groups.values()))
    levels = []
    for i, factor in enumerate(factors):
        for level in _levels(frame[factor]):
            cells = [values for key, values in groups.items() if key[i] == level]
            levels.append(_level(factor, level, cells, variance, df, confidence))
    complete = len(groups) == math.prod(frame[factor].nunique() for factor in factors)
    return MainEffects(tuple(levels), float(np.mean([values.mean() for values in groups.values()])), complete)


def interaction(
    frame: pd.DataFrame,
    row_factor: str,
    column_factor: str,
    response: str,
    confidence: float = 0.95,
    seed: int = 0,
    bounds: tuple[float, float] | None = (0.0, 1.0),
) -> InteractionTable:
    """Return the mean of every combination of two factors, by `mean_interval`, and what is left of it beside their sum.

    `frame` has one row per seed; factors that are not named are averaged over its rows. The residual is cell mean -
    row mean - column mean + grand mean, every cell weighing the same; in an incomplete design, what is left of the
    additive fit by least squares, which is the same where none is missing.

    Raises:
        ValueError: as `main_effects`, or a response lies outside `bounds`.
    """
    _check(frame, (row_factor, column_factor), response)
    groups = dict(_cells(frame, (row_factor, column_factor), response))
    rows, columns = _levels(frame[row_factor]), _levels(frame[column_factor])
    keys = list(groups)
    means = np.array([values.mean() for values in groups.values()])
    design = np.array([[row == r for r in rows] + [column == c for c in columns] for row, column in keys], dtype=float)
    residuals = dict(zip(keys, means - design @ np.linalg.lstsq(design, means, rcond=None)[0], strict=True))
    cells = []
    for row, column in product(rows, columns):
        if (row, column) not in groups:
            nan = math.nan
            cells.append(InteractionCell(row, column, nan, nan, nan, 0, NONE, nan))
            continue
        estimate = mean_interval(groups[row, column], confidence, seed, bounds)
        cells.append(
            InteractionCell(
                row,
                column,
                estimate.mean,
                estimate.low,
                estimate.high,
                estimate.n,
                estimate.method,
                float(residuals[row, column]),
            )
        )
    p = _interaction_p(groups, design)
    return InteractionTable(tuple(rows), tuple(columns), tuple(cells), len(groups) == len(cells), p)


def contrast(
    frame: pd.DataFrame, factors: Sequence[str], response: str, levels: tuple[str, Any, Any], confidence: float = 0.95
) -> Difference:
    """Return how far two levels of a factor are apart: the difference of the means that `main_effects` gives.

    `levels` is (factor, one, other). Interval and p are those of a linear contrast of independent means with their own
    variances (Welch 1947); where a cell has a single seed, of the pooled variance of all cells. NaN without scatter.

    Raises:
        ValueError: as `main_effects`, or there is no such level.
    """
    _check(frame, factors, response)
    groups = _cells(frame, factors, response)
    place = list(factors).index(levels[0])
    sides = [[values for key, values in groups if key[place] == level] for level in levels[1:]]
    if not all(sides):
        raise ValueError(f"{levels[0]} has no level {levels[1] if not sides[0] else levels[2]!r}")
    (one, variance, spread), (other, variance_b, spread_b) = (_mean_of_means(side) for side in sides)
    total, df = variance + variance_b, 0.0
    if not math.isnan(total):
        df = total**2 / (spread + spread_b) if spread + spread_b > 0 else 0.0
    else:
        pooled, df = _pooled([values for _, values in groups])
        total = sum(pooled * sum(1 / len(values) for values in side) / len(side) ** 2 for side in sides)
    n_one, n_other = (sum(map(len, side)) for side in sides)
    if not (df > 0 and total > 0):
        return Difference(one - other, math.nan, math.nan, math.nan, math.nan, n_one, n_other, NONE)
    error = math.sqrt(total)
    half = float(stdtrit(df, 0.5 + confident(confidence) / 2)) * error
    p = 2 * float(stdtr(df, -abs(one - other) / error))
    return Difference(one - other, one - other - half, one - other + half, p, df, n_one, n_other, CELLS)


def _mean_of_means(cells: Sequence[np.ndarray]) -> tuple[float, float, float]:
    """Return the mean of cell means, its variance, and what the degrees of freedom follow from; NaN with one seed."""
    mean = float(np.mean([values.mean() for values in cells]))
    if min(map(len, cells)) < 2:
        return mean, math.nan, math.nan
    squares = np.array([_variance(values) / len(values) for values in cells]) / len(cells) ** 2
    return mean, float(squares.sum()), float((squares**2 / (np.array([*map(len, cells)]) - 1)).sum())


def _variance(values: np.ndarray) -> float:
    """Return the variance between seeds, 0 where they are all the same: numpy's is some 1e-32 there."""
    return float(values.var(ddof=1)) if np.ptp(values) > 0 else 0.0


def _pooled(cells: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the pooled variance of all cells with two seeds or more, and its degrees of freedom; NaN and 0 without."""
    several = [values for values in cells if len(values) > 1]
    df = float(sum(len(values) - 1 for values in several))
    return (sum(_variance(values) * (len(values) - 1) for values in several) / df if df else math.nan), df


def _interaction_p(groups: Mapping[tuple[Any, ...], np.ndarray], design: np.ndarray) -> float:
    """Return the p of the ANOVA-type test of interaction (Brunner, Dette and Munk 1997): cell means against the sum of
    two effects, with cells' own variances; where a cell has a single seed, with the pooled one.
    """
    cells, sizes = list(groups.values()), np.array([len(values) for values in groups.values()])
    means = np.array([values.mean() for values in cells])
    beside = np.eye(len(cells)) - design @ np.linalg.pinv(design)  # projects means on what the sum leaves of them
    if np.trace(beside) < 0.5:  # a whole number but for rounding: its degrees of freedom
        return math.nan
    single, weights = sizes.min() < 2, beside.diagonal()
    pooled, left = _pooled(cells)
    variances = (pooled if single else np.array([_variance(values) for values in cells])) / sizes
    expected = float(weights @ variances)
    if not expected > 0:
        return math.nan
    if not single:
        left = expected**2 / float((weights**2 * variances**2 / (sizes - 1)).sum())
    df = expected**2 / float(variances @ beside**2 @ variances)
    return float(fdtrc(df, left, means @ beside @ means / expected))


def _level(
    factor: str, level: Any, cells: list[np.ndarray], pooled: float, pooled_df: float, confidence: float
) -> LevelMean:
    mean, total, spread = _mean_of_means(cells)
    low, high, method, df, name = math.nan, math.nan, NONE, 0.0, CELLS
    if not math.isnan(total):
        df = total**2 / spread if spread > 0 else 0.0
    else:
        total, df, name = pooled * sum(1 / len(values) for values in cells) / len(cells) ** 2, pooled_df, POOLED
    if df > 0 and total > 0:
        half = float(stdtrit(df, 0.5 + confidence / 2)) * math.sqrt(total)
        low, high, method = mean - half, mean + half, name
    return LevelMean(factor, level, mean, low, high, len(cells), sum(map(len, cells)), method)


def _check(frame: pd.DataFrame, factors: Sequence[str], response: str) -> None:
    if not factors:
        raise ValueError("effects need at least one factor")
    missing = [name for name in (*factors, response) if name not in frame.columns]
    if missing:
        raise ValueError(f"the frame has no column {', '.join(map(repr, missing))}")
    if frame.empty:
        raise ValueError("effects need at least one row")
    for name in (*factors, response):
        if frame[name].isna().any():
            raise ValueError(f"column {name!r} holds NaN; drop or fill those rows first")
    if not np.isfinite(frame[response].to_numpy(dtype=float)).all():
        raise ValueError(f"column {response!r} holds infinity")


def _cells(frame: pd.DataFrame, factors: Sequence[str], response: str) -> list[tuple[tuple[Any, ...], np.ndarray]]:
    """Return the levels and responses of every cell that is there."""
    keys = zip(*([_plain(value) for value in frame[factor]] for factor in factors), strict=True)
    cells: dict[tuple[Any, ...], list[float]] = {}
    for key, value in zip(keys, frame[response].to_numpy(dtype=float), strict=True):
        cells.setdefault(key, []).append(float(value))
    return [(key, np.array(values)) for key, values in cells.items()]


def _levels(column: pd.Series) -> list[Any]:
    """Return the levels in order, numbers by size; those that can't be compared by their names."""
    levels = list(dict.fromkeys(_plain(value) for value in column))
    try:
        return sorted(levels)
    except TypeError:
        return sorted(levels, key=str)


def _plain(value: Any) -> Any:
    """Return a scalar of numpy as Python's own, which JSON takes."""
    return value.item() if isinstance(value, np.generic) else value

"""What a factor does, in a sweep over several."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import stdtrit

from parking_exp.statistics.checks import confident
from parking_exp.statistics.intervals import NONE, mean_interval

if TYPE_CHECKING:  # a training imports this package and needs no frames of ours
    from collections.abc import Sequence

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
class Interaction:
    """All combinations, row by row; `complete` says whether none is missing."""

    rows: tuple[Any, ...]
    columns: tuple[Any, ...]
    cells: tuple[InteractionCell, ...]
    complete: bool


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
    pooled = [values for values in groups.values() if len(values) > 1]
    df = sum(len(values) - 1 for values in pooled)
    variance = sum(values.var(ddof=1) * (len(values) - 1) for values in pooled) / df if df else math.nan
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
) -> Interaction:
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
    return Interaction(tuple(rows), tuple(columns), tuple(cells), len(groups) == len(cells))


def _level(
    factor: str, level: Any, cells: list[np.ndarray], pooled: float, pooled_df: int, confidence: float
) -> LevelMean:
    sizes = np.array([len(values) for values in cells])
    mean, low, high, method = float(np.mean([values.mean() for values in cells])), math.nan, math.nan, NONE
    if sizes.min() > 1:
        squares = np.array([values.var(ddof=1) for values in cells]) / sizes / len(cells) ** 2
        total, spread = float(squares.sum()), float((squares**2 / (sizes - 1)).sum())
        df, name = (total**2 / spread if spread > 0 else 0.0), CELLS
    else:
        total, df, name = pooled * float((1 / sizes).sum()) / len(cells) ** 2, float(pooled_df), POOLED
    if df > 0 and total > 0:
        half = float(stdtrit(df, 0.5 + confidence / 2)) * math.sqrt(total)
        low, high, method = mean - half, mean + half, name
    return LevelMean(factor, level, mean, low, high, len(cells), int(sizes.sum()), method)


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

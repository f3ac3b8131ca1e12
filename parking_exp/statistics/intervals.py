"""Confidence intervals of means over seeds.

The replicate is the training seed. Rates of good cells pile up below 1 with a tail to the left. There the t-interval
covers far less than 95 % (81 % for 5 seeds around 0.9 with a deviation of 0.15). The studentised bootstrap covers 95 %
from 5 seeds on, except where seeds collapse (`coverage_note`); `tests/support/coverage_simulation.py` simulates it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from parking_exp.errors import plural
from parking_exp.statistics.rates import finite, finite_or_none

NONE = "none"
T = "t"
SCORE = "score, effective sample size"
BOOTSTRAP = "bootstrap-t"
EXACT = "exact bound, no scatter"

MIN_TO_RESAMPLE = 5  # below, the resamples without scatter alone decide where the interval ends
BAND_RESAMPLES = 1999
ROUNDING = 1e-9  # how far a rate may lie outside 0 ... 1
CHUNK = 256  # rows that are resampled at once: 256 x 9,999 floats are 20 MB

# When to warn that an interval covers less than it says.
GAP = 0.3  # between neighbouring seeds: rare without a collapse, nearly certain with one
COLLAPSED_COVERS = ((10, 62), (20, 66), (30, 86))  # below so many seeds, percent; 95 from 30


@dataclass(frozen=True)
class Interval:
    """A number with its confidence interval.

    Attributes:
        value: e.g. the mean over seeds; None without data.
        low, high: None where the data allow for no interval, e.g. over one seed.
        n: seeds behind it; behind a difference, those of the side that has fewer.
        method: how the interval was made.
    """

    value: float | None
    low: float | None = None
    high: float | None = None
    n: int = 0
    method: str = NONE

    def clipped(self, least: float, most: float) -> "Interval":
        """Return the same interval with its ends within `least` ... `most`."""
        low, high = (None if end is None else min(max(end, least), most) for end in (self.low, self.high))
        return Interval(self.value, low, high, self.n, self.method)


def mean_interval(rates: ArrayLike, resamples: int = 9999) -> Interval:
    """Return the mean of rates in 0 ... 1, shape (seeds,), with an interval for the mean of all possible seeds.

    The method depends on the data. One seed has no interval. From 5 seeds, it is the studentised bootstrap (Efron &
    Tibshirani 1993, 12.5) within the bound below. With 2 to 4, it is Wilson's interval with t's quantile and the
    effective sample size (Korn & Graubard 1998; Dean & Pagano 2015). Seeds without scatter get the bound that holds for
    every distribution: if all `n` rates are at least c, then by Markov's inequality the mean is at least
    c (alpha / 2)^(1/n), and likewise from above. Ten seeds at 100 % leave 0.69 ... 1.

    Raises:
        ValueError: no rates, NaN, or rates outside 0 ... 1.
    """
    array = finite(rates, "a mean over seeds")
    low, high, methods = interval_rows(array[None], resamples)
    return Interval(float(array.mean()), finite_or_none(low[0]), finite_or_none(high[0]), len(array), methods[0])


def student_interval(values: ArrayLike) -> Interval:
    """Return the mean of any numbers, shape (seeds,), with Student's interval; none for one seed or without scatter."""
    array = finite(values, "a mean over seeds")
    mean, n = float(array.mean()), len(array)
    if np.ptp(array) == 0:
        return Interval(mean, n=n)
    half = float(stdtrit(n - 1, 0.975) * array.std(ddof=1) / np.sqrt(n))
    return Interval(mean, mean - half, mean + half, n, T)


def mean_band(rates: ArrayLike) -> list[Interval]:
    """Return `mean_interval` of every column of `rates`, shape (seeds, points): the band around a learning curve.

    The band holds point by point, not for the whole curve at once. NaN means that a run was not measured there: a point
    counts the seeds that it has, and a point without any has n = 0 and no value.
    """
    table = np.asarray(rates, dtype=float)
    columns, counts = table.T, np.count_nonzero(~np.isnan(table), axis=0)
    band = [Interval(None)] * len(columns)
    for count in np.unique(counts[counts > 0]):
        where = np.flatnonzero(counts == count)
        rows = np.array([columns[i][~np.isnan(columns[i])] for i in where])
        lows, highs, methods = interval_rows(rows, BAND_RESAMPLES)
        for i, row, low, high, method in zip(where, rows, lows, highs, methods, strict=True):
            band[i] = Interval(float(row.mean()), finite_or_none(low), finite_or_none(high), int(count), method)
    return band


def interval_rows(rows: np.ndarray, resamples: int) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return the ends of `mean_interval` for every row of `rows`, shape (r, n), NaN for none, and the methods."""
    if not ((rows >= -ROUNDING) & (rows <= 1 + ROUNDING)).all():
        raise ValueError("rates lie outside 0 ... 1")
    rows, n = np.clip(rows, 0, 1), rows.shape[1]
    if n == 1:
        return np.full(len(rows), np.nan), np.full(len(rows), np.nan), [NONE] * len(rows)
    floor, ceiling = exact_bound(rows.min(axis=1), rows.max(axis=1), n)
    low, high = floor.copy(), ceiling.copy()
    scatter = np.ptp(rows, axis=1) > 0
    live = rows[scatter]
    mean, error = live.mean(axis=1), live.std(axis=1, ddof=1) / np.sqrt(n)
    if n < MIN_TO_RESAMPLE:
        low[scatter], high[scatter] = score_interval(mean, error**2, n - 1)
        method = SCORE
    else:
        lower, upper = studentised(live, resamples)
        low[scatter] = np.maximum(mean - upper * error, floor[scatter])
        high[scatter] = np.minimum(mean - lower * error, ceiling[scatter])
        method = BOOTSTRAP
    return low, high, [method if scatters else EXACT for scatters in scatter]


def exact_bound(least: ArrayLike, most: ArrayLike, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of a mean in 0 ... 1 that hold for every distribution, from the extremes of `n` draws."""
    factor = 0.025 ** (1 / n)
    return np.asarray(least) * factor, 1 - (1 - np.asarray(most)) * factor


def score_interval(mean: np.ndarray, variance: np.ndarray, df: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return Wilson's interval of means in 0 ... 1 that have the variance `variance` > 0, with t's quantile.

    The effective sample size is mean (1 - mean) / variance: that many trials of a coin would have this variance.
    """
    quantile = stdtrit(df, 0.975)
    size = mean * (1 - mean) / variance
    scale = 1 / (1 + quantile**2 / size)
    centre = scale * (mean + quantile**2 / (2 * size))
    half = scale * quantile * np.sqrt(variance + quantile**2 / (4 * size**2))
    return centre - half, centre + half


def studentised(rows: np.ndarray, resamples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return two quantiles of (resampled mean - mean) / resampled error for every row of `rows`, shape (r, n).

    A resample without scatter counts as infinitely far off, on its side.
    """
    n = rows.shape[1]
    weights = _resample_weights(n, resamples)
    quantiles = np.empty((2, len(rows)))
    for start in range(0, len(rows), CHUNK):
        block = rows[start : start + CHUNK]
        z = (block - block.mean(axis=1, keepdims=True)) / block.std(axis=1, ddof=1, keepdims=True)
        shift = z @ weights
        variance = np.maximum(z**2 @ weights - shift**2, 0)
        flat = variance < 1e-12
        deviation = shift / np.sqrt(np.where(flat, 1, variance) / (n - 1))
        deviation[flat] = np.sign(shift[flat]) * 1e9
        quantiles[:, start : start + CHUNK] = np.quantile(deviation, (0.025, 0.975), axis=1)
    return quantiles[0], quantiles[1]


@lru_cache(maxsize=32)
def _resample_weights(n: int, resamples: int) -> np.ndarray:
    """Return the share that each of `n` values has of each resample, shape (n, resamples)."""
    drawn = np.random.default_rng(0).multinomial(n, np.full(n, 1 / n), resamples)
    return np.ascontiguousarray(drawn.T / n)


def coverage_note(values: ArrayLike) -> str | None:
    """Return a sentence where seeds look like those whose 95 % interval covered less than 93 % in simulation, or None.

    `values`, shape (seeds,), are rates in 0 ... 1. The percentages are those of `tests/support/coverage_simulation.py`.
    Collapses that no seed shows go unnoticed (see `unseen_share`).
    """
    rates = finite(values, "a note on coverage")
    if len(rates) < MIN_TO_RESAMPLE:
        return (
            f"{plural(len(rates), 'seed')}: too few for a reliable interval; with fewer than {MIN_TO_RESAMPLE}, "
            "95 % intervals covered 89 % where rates scatter widely below the ceiling, and 59 % where one in ten "
            "collapses."
        )
    gap = float(np.diff(np.sort(rates)).max())
    covered = next((percent for below, percent in COLLAPSED_COVERS if len(rates) < below), None)
    if gap > GAP and covered is not None:
        return (
            f"The {len(rates)} seeds fall into two groups, {100 * gap:.0f} points apart: where one seed in ten "
            f"collapses, 95 % intervals from about as many covered {covered} %."
        )
    return None

"""Confidence intervals of means over seeds.

The replicate is the training seed. Rates of good cells pile up below 1 with a tail to the left, and there the
t-interval covers far less than it says (81 % for 5 seeds around 0.9 with a deviation of 0.15) and BCa hardly more,
with 20 seeds too (91 %). The studentised bootstrap holds its 95 % from 5 seeds on, except where seeds collapse
(`coverage_note`); `tests/support/coverage_simulation.py` is the simulation.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from parking_exp.statistics.checks import finite, finite_or_none

NONE = "none"
T = "t"
SCORE = "score, effective sample size"
BOOTSTRAP = "bootstrap-t"
EXACT = "exact bound, no scatter"

FEWEST_TO_RESAMPLE = 5  # below, the resamples without scatter alone decide where the interval ends
FEWEST_UNBOUNDED = 20  # without bounds, nothing catches a resample without scatter
BEYOND = 1e9  # the studentised deviation of a resample that has no scatter
ROUNDING = 1e-9  # how far a value may lie outside its bounds
CHUNK = 256  # rows that are resampled at once: 256 x 9,999 floats are 20 MB


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


def mean_interval(
    values: ArrayLike,
    confidence: float = 0.95,
    seed: int = 0,
    bounds: tuple[float, float] | None = (0.0, 1.0),
    resamples: int = 9999,
) -> Interval:
    """Return the mean of `values`, shape (seeds,), with an interval for the mean of all seeds there could be.

    Methods, by what the data allow: one value has no interval ("none"). From 5 seeds, the studentised bootstrap
    (Efron & Tibshirani 1993, 12.5), cut at the bound below. With 2 to 4, Wilson's interval with t's quantile and the
    sample size that the variance between seeds amounts to (Korn & Graubard 1998; Dean & Pagano 2015). Seeds without
    any scatter get the bound that holds for every distribution within `bounds`: if all `n` values are at least `c`
    above the lower one, then by Markov's inequality the mean is at least c (alpha / 2)^(1/n) above it, and likewise
    from above. Ten seeds at 100 % leave 0.69 ... 1. Without `bounds` it is t's interval below 20 seeds, the bootstrap
    from there, and none without scatter.

    Raises:
        ValueError: no values, NaN, or values outside `bounds`.
    """
    array = finite(values, "a mean over seeds")
    low, high, methods = interval_rows(array[None], confidence, seed, bounds, resamples)
    return Interval(float(array.mean()), finite_or_none(low[0]), finite_or_none(high[0]), len(array), methods[0])


def mean_band(
    values: ArrayLike,
    confidence: float = 0.95,
    seed: int = 0,
    bounds: tuple[float, float] | None = (0.0, 1.0),
    resamples: int = 1999,
) -> list[Interval]:
    """Return `mean_interval` of every column of `values`, shape (seeds, points): the band around a learning curve.

    The band holds point by point, not for the whole curve at once. NaN means that a run was not measured there (it
    ended sooner): a point counts the seeds that it has, and a point without any has n = 0 and no value.

    Raises:
        ValueError: values lie outside `bounds`.
    """
    table = np.asarray(values, dtype=float)
    columns, counts = table.T, np.count_nonzero(~np.isnan(table), axis=0)
    band = [Interval(None)] * len(columns)
    for count in np.unique(counts[counts > 0]):
        where = np.flatnonzero(counts == count)
        rows = np.array([columns[i][~np.isnan(columns[i])] for i in where])
        low, high, methods = interval_rows(rows, confidence, seed, bounds, resamples)
        for i, row, a, b, method in zip(where, rows, low, high, methods, strict=True):
            band[i] = Interval(float(row.mean()), finite_or_none(a), finite_or_none(b), int(count), method)
    return band


def interval_rows(
    rows: np.ndarray, confidence: float, seed: int, bounds: tuple[float, float] | None, resamples: int
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return low and high of the mean of every row of `rows`, shape (r, n), as `mean_interval` does, and the
    methods."""
    if bounds is not None:
        scaled = (rows - bounds[0]) / (bounds[1] - bounds[0])
        if not ((scaled >= -ROUNDING) & (scaled <= 1 + ROUNDING)).all():
            raise ValueError(f"values lie outside their bounds, {bounds[0]:g} ... {bounds[1]:g}")
        low, high, methods = _bounded(np.clip(scaled, 0, 1), confidence, seed, resamples)
        return bounds[0] + low * (bounds[1] - bounds[0]), bounds[0] + high * (bounds[1] - bounds[0]), methods
    n = rows.shape[1]
    scatter = np.ptp(rows, axis=1) > 0
    low, high = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    methods = [NONE] * len(rows)
    if n > 1 and scatter.any():
        live, method = rows[scatter], T
        mean, error = live.mean(axis=1), live.std(axis=1, ddof=1) / np.sqrt(n)
        quantile = stdtrit(n - 1, 0.5 + confidence / 2)
        below, above = quantile * error, quantile * error
        if n >= FEWEST_UNBOUNDED:
            lower, upper = studentised(live, confidence, seed, resamples)
            tame = (lower > -BEYOND / 2) & (upper < BEYOND / 2)
            below, above = np.where(tame, upper * error, below), np.where(tame, -lower * error, above)
            method = BOOTSTRAP
        low[scatter], high[scatter] = mean - below, mean + above
        methods = [method if scatters else NONE for scatters in scatter]
    return low, high, methods


def _bounded(
    rows: np.ndarray, confidence: float, seed: int, resamples: int
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return the intervals of rows within 0 ... 1."""
    n = rows.shape[1]
    if n == 1:
        nothing = np.full(len(rows), np.nan)
        return nothing, nothing.copy(), [NONE] * len(rows)
    factor = ((1 - confidence) / 2) ** (1 / n)
    floor, ceiling = rows.min(axis=1) * factor, 1 - (1 - rows.max(axis=1)) * factor
    low, high = floor.copy(), ceiling.copy()
    scatter = np.ptp(rows, axis=1) > 0
    live = rows[scatter]
    mean, error = live.mean(axis=1), live.std(axis=1, ddof=1) / np.sqrt(n)
    if n < FEWEST_TO_RESAMPLE:
        low[scatter], high[scatter] = score_interval(mean, error**2, n - 1, confidence)
        method = SCORE
    else:
        lower, upper = studentised(live, confidence, seed, resamples)
        low[scatter] = np.maximum(mean - upper * error, floor[scatter])
        high[scatter] = np.minimum(mean - lower * error, ceiling[scatter])
        method = BOOTSTRAP
    return low, high, [method if scatters else EXACT for scatters in scatter]


def score_interval(
    mean: np.ndarray, variance: np.ndarray, df: ArrayLike, confidence: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return Wilson's interval of means in 0 ... 1 whose own variance is `variance` > 0, with t's quantile.

    The effective sample size is mean (1 - mean) / variance: as many trials of a coin would give this variance.
    """
    quantile = stdtrit(df, 0.5 + confidence / 2)
    size = mean * (1 - mean) / variance
    scale = 1 / (1 + quantile**2 / size)
    centre = scale * (mean + quantile**2 / (2 * size))
    half = scale * quantile * np.sqrt(variance + quantile**2 / (4 * size**2))
    return centre - half, centre + half


def studentised(rows: np.ndarray, confidence: float, seed: int, resamples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return two quantiles of (resampled mean - mean) / resampled error for every row of `rows`, shape (r, n).

    A resample without scatter, drawn from rows that have some, counts as infinitely far off, on its side.
    """
    n = rows.shape[1]
    weights = _weights(n, seed, resamples)
    tails = (0.5 - confidence / 2, 0.5 + confidence / 2)
    quantiles = np.empty((2, len(rows)))
    for start in range(0, len(rows), CHUNK):
        block = rows[start : start + CHUNK]
        z = (block - block.mean(axis=1, keepdims=True)) / block.std(axis=1, ddof=1, keepdims=True)
        shift = z @ weights
        variance = np.maximum(z**2 @ weights - shift**2, 0)
        flat = variance < 1e-12
        deviation = shift / np.sqrt(np.where(flat, 1, variance) / (n - 1))
        deviation[flat] = np.sign(shift[flat]) * BEYOND
        quantiles[:, start : start + CHUNK] = np.quantile(deviation, tails, axis=1)
    return quantiles[0], quantiles[1]


@lru_cache(maxsize=32)
def _weights(n: int, seed: int, resamples: int) -> np.ndarray:
    """Return the share that each of `n` values has of each resample, shape (n, resamples)."""
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), resamples)
    return np.ascontiguousarray(drawn.T / n)

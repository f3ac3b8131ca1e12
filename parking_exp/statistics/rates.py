"""Rates of episodes and of seeds."""

import math
from numbers import Real

from numpy.typing import ArrayLike


def finite_or_none(value: object) -> float | None:
    """Return a finite number as a float, None for anything else."""
    return float(value) if isinstance(value, Real) and math.isfinite(value) else None


Z = 1.959963984540054  # the normal quantile of a two-sided 95 % interval


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's score interval of a rate (Wilson 1927).

    Every evaluation calls it, so it does without scipy.
    """
    rate = successes / trials
    scale = 1 / (1 + Z**2 / trials)
    centre = scale * (rate + Z**2 / (2 * trials))
    half = scale * Z * math.sqrt(rate * (1 - rate) / trials + Z**2 / (4 * trials**2))
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return low, high


def interquartile_mean(values: ArrayLike) -> float:
    """Return the mean without the lowest and the highest quarter of seeds.

    A quarter is rounded down to whole seeds. `values` has the shape (seeds,).
    """
    from scipy import stats

    return float(stats.trim_mean(values, 0.25))


def largest_hidden_share(n: int) -> float:
    """Return the largest share of seeds that may collapse although none of `n` did.

    It is the one-sided bound of Clopper and Pearson (1934). With 10 seeds it is 0.26: no interval
    computed from ten good seeds accounts for failures that they do not show.
    """
    return 1 - 0.05 ** (1 / n)

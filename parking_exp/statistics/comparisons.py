"""Comparison of two cells: Welch's test, probability of improvement, Holm's correction. Seeds are not paired."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.rates import Z, finite


@dataclass(frozen=True)
class Difference(Interval):
    """mean(a) - mean(b) with its interval, two-sided p and degrees of freedom; None where the data allow for none."""

    p: float | None = None
    df: float | None = None


def welch(a: ArrayLike, b: ArrayLike) -> Difference:
    """Return the difference of two means over seeds, shapes (n_a,) and (n_b,), by Welch's test (Welch 1947).

    With fewer than two seeds on a side, there is neither an interval nor p. Where neither side scatters, Welch's test
    is undefined: there is no interval, and p is 1 for equal values, else that of the exact permutation test,
    2 / binom(n_a + n_b, n_a): 10 against 10 seeds give 0.00001, 2 against 2 only 0.33.

    Raises:
        ValueError: a side is empty or holds NaN.
    """
    from scipy import stats

    first, second = finite(a, "a difference of means"), finite(b, "a difference of means")
    m, n = len(first), len(second)
    difference = float(first.mean() - second.mean())
    if min(m, n) < 2:
        return Difference(difference, n=min(m, n))
    if np.ptp(first) == 0 and np.ptp(second) == 0:
        p = 1.0 if first[0] == second[0] else 2 / math.comb(m + n, m)
        return Difference(float(first[0] - second[0]), n=min(m, n), method="permutation, no scatter", p=p)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of one side without scatter
        test = stats.ttest_ind(first, second, equal_var=False)
    low, high = map(float, test.confidence_interval())
    return Difference(difference, low, high, min(m, n), "Welch", float(test.pvalue), float(test.df))


def probability_of_improvement(a: ArrayLike, b: ArrayLike) -> Interval:
    """Return how probable it is that a seed of `a`, shape (n_a,), beats one of `b`, (n_b,); ties count one half.

    The interval is `newcombe`. With one seed on both sides it is nearly 0 ... 1.

    Raises:
        ValueError: a side is empty or holds NaN.
    """
    first, second = finite(a, "a probability of improvement"), finite(b, "a probability of improvement")
    m, n = len(first), len(second)
    theta = float((1 + np.sign(first[:, None] - second[None])).mean() / 2)
    return Interval(theta, *newcombe(theta, m, n), min(m, n), "Newcombe 5")


def newcombe(theta: float, m: int, n: int) -> tuple[float, float]:
    """Return the ends where |theta - x| = z sqrt(V(x)): Newcombe's method 5 (2006, Statistics in Medicine 25:559-573).

    V is Hanley & McNeil's variance with the mean of m and n in the place of both. The interval stays within 0 ... 1 and
    has width at either end.
    """
    from scipy.optimize import brentq

    size = (m + n) / 2

    def excess(x: float) -> float:
        variance = x * (1 - x) * (1 + (size - 1) * ((1 - x) / (2 - x) + x / (1 + x))) / (m * n)
        return abs(theta - x) - Z * math.sqrt(variance)

    low = brentq(excess, 0, theta - 1e-9) if theta > 0 else 0.0
    high = brentq(excess, theta + 1e-9, 1) if theta < 1 else 1.0
    return low, high


def holm(p_values: Sequence[float | None] | np.ndarray) -> np.ndarray:
    """Return Holm's adjusted p-values, same order and shape (n,) (Holm 1979).

    NaN and None are no part of the family, and become NaN.

    Raises:
        ValueError: a p-value lies outside 0 ... 1.
    """
    p = np.asarray(p_values, dtype=float)
    known = np.flatnonzero(~np.isnan(p))
    if ((p[known] < 0) | (p[known] > 1)).any():
        raise ValueError("p-values lie between 0 and 1")
    order = known[np.argsort(p[known], kind="stable")]
    adjusted = np.full(p.shape, np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)), 1)
    return adjusted

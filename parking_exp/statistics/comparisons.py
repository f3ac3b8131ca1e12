"""Comparison of two cells: Welch's test, probability of improvement, Holm's correction. Seeds are not paired."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from parking_exp.statistics.checks import finite
from parking_exp.statistics.intervals import Interval

WELCH = "Welch"
PERMUTATION = "permutation, no scatter"
NEWCOMBE = "Newcombe 5"


@dataclass(frozen=True)
class Difference(Interval):
    """mean(a) - mean(b) with its interval, two-sided p and degrees of freedom; None where the data allow for none."""

    p: float | None = None
    df: float | None = None


def welch(a: ArrayLike, b: ArrayLike, confidence: float = 0.95) -> Difference:
    """Return the difference of two means over seeds, shapes (n_a,) and (n_b,), by Welch's test (Welch 1947).

    With fewer than two seeds on a side, there are neither interval nor p. Where neither side scatters, Welch is
    undefined: there is no interval; p is 1 for equal values and else that of the exact permutation test,
    2 / binom(n_a + n_b, n_a): 10 against 10 seeds give 0.00001, 2 against 2 only 0.33.

    Raises:
        ValueError: a side is empty or holds NaN.
    """
    from scipy import stats  # half a second that only reports pay

    first, second = finite(a, "a difference of means"), finite(b, "a difference of means")
    m, n = len(first), len(second)
    difference = float(first.mean() - second.mean())
    if min(m, n) < 2:
        return Difference(difference, n=min(m, n))
    if np.ptp(first) == 0 and np.ptp(second) == 0:
        p = 1.0 if first[0] == second[0] else 2 / math.comb(m + n, m)
        return Difference(float(first[0] - second[0]), n=min(m, n), method=PERMUTATION, p=p)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of one side without scatter
        test = stats.ttest_ind(first, second, equal_var=False)
    low, high = map(float, test.confidence_interval(confidence))
    return Difference(difference, low, high, min(m, n), WELCH, float(test.pvalue), float(test.df))


def probability_of_improvement(a: ArrayLike, b: ArrayLike, confidence: float = 0.95) -> Interval:
    """Return how probable it is that a seed of `a`, shape (n_a,), beats one of `b`, (n_b,); ties count one half.

    Newcombe's method 5 (Newcombe 2006, Statistics in Medicine 25:559-573): a score interval whose variance is Hanley
    & McNeil's at the bound itself, with the mean of n_a and n_b in the place of both. It stays within 0 ... 1 and has
    width at either end. With one seed on both sides it is nearly 0 ... 1.

    Raises:
        ValueError: a side is empty or holds NaN.
    """
    first, second = finite(a, "a probability of improvement"), finite(b, "a probability of improvement")
    m, n = len(first), len(second)
    theta = (1 + np.sign(first[:, None] - second[None])).mean() / 2
    low, high = newcombe(theta, m, n, confidence)
    return Interval(float(theta), float(low), float(high), min(m, n), NEWCOMBE)


def newcombe(theta: ArrayLike, m: int, n: int, confidence: float) -> tuple[np.ndarray, np.ndarray]:
    """Return where |theta - x| = z sqrt(V(x)) below and above `theta`, by bisection; any shape."""
    at = np.asarray(theta, dtype=float)
    z, size = float(ndtri(0.5 + confidence / 2)), (m + n) / 2

    def inside(x: np.ndarray) -> np.ndarray:
        variance = x * (1 - x) * (1 + (size - 1) * ((1 - x) / (2 - x) + x / (1 + x))) / (m * n)
        return np.abs(at - x) <= z * np.sqrt(variance)

    def edge(outside: np.ndarray) -> np.ndarray:
        near, far = at.copy(), outside
        for _ in range(60):
            middle = (near + far) / 2
            within = inside(middle)
            near, far = np.where(within, middle, near), np.where(within, far, middle)
        return near

    return edge(np.zeros_like(at)), edge(np.ones_like(at))


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

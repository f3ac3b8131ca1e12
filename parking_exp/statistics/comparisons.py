"""Comparison of cells: differences of means, and tests of them. Seeds are not paired."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.means import SeedRates, mean_interval
from parking_exp.statistics.permutation import permutation_p
from parking_exp.statistics.rates import finite_or_none

Cells = Sequence[SeedRates]
ENOUGH_FOR_A_TEST = 4  # seeds on each side: three against three have no p below 0.1


@dataclass(frozen=True)
class Difference(Interval):
    """mean(a) - mean(b) with its interval, and the two-sided p of the permutation test.

    Attributes:
        p: None where a side has fewer than ENOUGH_FOR_A_TEST seeds, or a cell has a single one.
        p_corrected: the same with Bonferroni's correction.
    """

    p: float | None = None
    p_corrected: float | None = None


def compare(
    pairs: Sequence[tuple[Cells, Cells]], alpha: float = 0.05, n_pairs: int = 0
) -> list[Difference]:
    """Return the difference between the means of both sides, for each pair of a family.

    The mean of a side is the mean of its cells' means. Cells are matched by position, and seeds are
    permuted within matched cells. Bonferroni's correction counts the pairs that have a p. It also
    makes their intervals simultaneous.

    Args:
        pairs: the cells of both sides of each pair, as many on each side.
        alpha: the intervals of the family hold together at the level 1 - alpha.
        n_pairs: the number of pairs if the family is larger; 0: count the pairs that have a p.
    """
    p_values = [_test(a, b) for a, b in pairs]
    family_size = max(1, n_pairs, sum(p is not None for p in p_values))

    differences = []
    for (a, b), p in zip(pairs, p_values, strict=True):
        interval = contrast(a, b, alpha / family_size)
        p_corrected = None if p is None else min(1, family_size * p)
        differences.append(
            Difference(interval.value, interval.low, interval.high, interval.n, p, p_corrected)
        )
    return differences


def _test(a: Cells, b: Cells) -> float | None:
    if min(_count_seeds(a), _count_seeds(b)) < ENOUGH_FOR_A_TEST:
        return None
    if min(np.size(cell.rates) for cell in [*a, *b]) == 1:  # there is no interval, so no verdict
        return None
    return permutation_p([(x.rates, y.rates) for x, y in zip(a, b, strict=True)])


def contrast(plus: Cells, minus: Cells = (), alpha: float = 0.05) -> Interval:
    """Return the mean of the means of `plus`, minus the mean of the means of `minus` if given.

    Its interval, at the level 1 - alpha, combines the intervals of the cells. The distances of
    their ends from their means are added in squares (Zou & Donner 2008). There is no interval if
    a cell has a single seed.
    """
    value, below, above = _average(plus, alpha)
    n = _count_seeds(plus)
    if minus:
        subtracted, subtracted_below, subtracted_above = _average(minus, alpha)
        value -= subtracted
        below = math.hypot(below, subtracted_above)
        above = math.hypot(above, subtracted_below)
        n = min(n, _count_seeds(minus))
    return Interval(value, finite_or_none(value - below), finite_or_none(value + above), n)


def _average(cells: Cells, alpha: float) -> tuple[float, float, float]:
    """Return the mean of cells' means, and how far the ends of its interval lie below and above.

    These are NaN where a cell has a single seed.
    """
    intervals = [mean_interval(cell.rates, cell.n_episodes, alpha) for cell in cells]
    means = np.array([interval.value for interval in intervals], dtype=float)
    lows = np.array([interval.low for interval in intervals], dtype=float)
    highs = np.array([interval.high for interval in intervals], dtype=float)
    below = np.linalg.norm(means - lows) / len(cells)
    above = np.linalg.norm(highs - means) / len(cells)
    return float(means.mean()), float(below), float(above)


def _count_seeds(cells: Cells) -> int:
    return sum(np.size(cell.rates) for cell in cells)

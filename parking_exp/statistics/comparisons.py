"""Comparison of cells: differences, ranks, and corrections for many pairs. Seeds are not paired."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.means import SeedRates, contrast

Cells = Sequence[SeedRates]


@dataclass(frozen=True)
class Difference(Interval):
    """mean(a) - mean(b) with its interval, and its two-sided p.

    Attributes:
        p: None where a cell has a single seed.
        p_corrected: the same with Bonferroni's correction.
    """

    p: float | None = None
    p_corrected: float | None = None


def compare(
    pairs: Sequence[tuple[Cells, Cells]], alpha: float = 0.05, n_pairs: int = 0
) -> list[Difference]:
    """Return the difference of each pair of a family: the mean of some cells' means minus others'.

    Bonferroni's correction makes the family's intervals simultaneous, and 0 lies outside exactly
    where the corrected p is below alpha. (Holm's smaller p has no such intervals.) Where a cell has
    a single seed there is neither p nor interval, and the pair is no part of the family. `n_pairs`
    is the number of pairs of a larger family.
    """
    contrasts = [contrast(a, b) for a, b in pairs]
    family_size = max(1, n_pairs, sum(each.p is not None for each in contrasts))

    differences = []
    for each in contrasts:
        interval = each.interval(alpha / family_size)
        p = each.p
        p_corrected = None if p is None else min(1, family_size * p)
        differences.append(
            Difference(interval.value, interval.low, interval.high, interval.n, p, p_corrected)
        )
    return differences


def rank_test(a: ArrayLike, b: ArrayLike) -> float | None:
    """Return the two-sided p of Mann and Whitney's test (1947) of seeds, shapes (n_a,) and (n_b,).

    It is exact without ties. With fewer than two seeds on a side there is none.
    """
    from scipy import stats

    if min(np.size(a), np.size(b)) < 2:
        return None
    return float(stats.mannwhitneyu(a, b).pvalue)


def holm(p_values: Sequence[float | None] | np.ndarray) -> np.ndarray:
    """Return Holm's adjusted p-values, same order and shape (n,) (Holm 1979).

    NaN and None are no part of the family, and become NaN.
    """
    p = np.asarray(p_values, dtype=float)
    size = np.count_nonzero(~np.isnan(p))
    order = np.argsort(p, kind="stable")[:size]  # NaN come last

    multiplied = p[order] * np.arange(size, 0, -1)
    adjusted = np.full(p.shape, np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(multiplied), 1)
    return adjusted

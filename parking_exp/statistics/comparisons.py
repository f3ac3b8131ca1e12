"""Comparison of cells: differences, ranks, and corrections for many pairs. Seeds are not paired."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.means import SeedRates, contrast
from parking_exp.statistics.rates import finite

Cells = Sequence[SeedRates]


@dataclass(frozen=True)
class Difference(Interval):
    """mean(a) - mean(b) with its interval, and two-sided p, also corrected by Bonferroni; None
    where there is none.
    """

    p: float | None = None
    p_corrected: float | None = None


def compare(pairs: Sequence[tuple[Cells, Cells]], alpha: float = 0.05) -> list[Difference]:
    """Return the differences of a family of pairs: the mean of some cells' means minus that of
    others.

    Bonferroni's correction makes the family's intervals simultaneous, and 0 lies outside exactly
    where the corrected p is below alpha. (Holm's smaller p has no such intervals.) Where a cell has
    a single seed there is neither p nor interval, and the pair is no part of the family.
    """
    contrasts = [contrast(a, b) for a, b in pairs]
    size = max(1, sum(draws.p is not None for draws in contrasts))
    return [
        Difference(
            **vars(draws.interval(alpha / size)),
            p=draws.p,
            p_corrected=None if draws.p is None else min(1, size * draws.p),
        )
        for draws in contrasts
    ]


def rank_test(a: ArrayLike, b: ArrayLike) -> float | None:
    """Return the two-sided p of Mann and Whitney's test (1947) of seeds, shapes (n_a,) and (n_b,).

    It is exact without ties. With fewer than two seeds on a side there is none.

    Raises:
        ValueError: a side is empty or holds NaN.
    """
    from scipy import stats

    first, second = finite(a, "a rank test"), finite(b, "a rank test")
    if min(len(first), len(second)) < 2:
        return None
    if np.ptp([*first, *second]) == 0:
        return 1.0
    return float(stats.mannwhitneyu(first, second, method="auto").pvalue)


def probability_of_improvement(a: ArrayLike, b: ArrayLike) -> float:
    """Return how often a seed of `a`, shape (n_a,), beats one of `b`, (n_b,); ties count one half.

    It is the effect size of `rank_test`.

    Raises:
        ValueError: a side is empty or holds NaN.
    """
    first, second = (
        finite(a, "a probability of improvement"),
        finite(b, "a probability of improvement"),
    )
    return float((1 + np.sign(first[:, None] - second[None])).mean() / 2)


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

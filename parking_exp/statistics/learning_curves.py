"""Learning curves: the area under one, and the time to a threshold.

Runs that never reach the threshold are censored.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class SurvivalCurve:
    """The share of runs that have reached the threshold by each of `times` (1 - S).

    Before the first of `times`, none has.
    """

    times: tuple[float, ...]
    reached: tuple[float, ...]
    median: float | None  # None where fewer than half have
    n: int  # runs
    k: int  # runs that have reached the threshold


def normalised_area(steps: ArrayLike, values: ArrayLike) -> float:
    """Return the area under a learning curve over the range of its steps: 1 means always at 1.

    The area is that of trapezoids between evaluations, divided by the range that they cover. NaN
    values are dropped. A single evaluation is its own area.
    """
    value = np.asarray(values, dtype=float)
    known = ~np.isnan(value)
    value = value[known]
    at = np.asarray(steps)[known]
    if len(at) == 1:
        return float(value[0])
    return float(np.trapezoid(value, at) / (at[-1] - at[0]))


def steps_to(
    steps: ArrayLike, rates: ArrayLike, threshold: float = 0.9, hold: int = 3
) -> tuple[float, bool]:
    """Return the first step from which `hold` evaluations in a row reach a threshold, and True.

    Where there is none, the run is censored at the last step from which that could have been seen,
    that of the `hold`-th evaluation from the end (0 with fewer): return that and False. `steps`,
    shape (evaluations,), rises; NaN rates are below the threshold.
    """
    at = np.asarray(steps)
    if len(at) < hold:
        return 0.0, False
    reached = np.asarray(rates, dtype=float) >= threshold
    held = np.lib.stride_tricks.sliding_window_view(reached, hold).all(axis=1)
    if held.any():
        return float(at[held.argmax()]), True
    return float(at[-hold]), False


def kaplan_meier(times: ArrayLike, observed: ArrayLike) -> SurvivalCurve:
    """Return the product-limit estimate of the share that has reached (Kaplan & Meier 1958).

    It has every distinct time. `times` and `observed`, shape (runs,), are as `steps_to` gives them.
    """
    from scipy import stats

    at = np.asarray(times, dtype=float)
    is_observed = np.asarray(observed, dtype=bool)
    data = stats.CensoredData(uncensored=at[is_observed], right=at[~is_observed])
    survival = stats.ecdf(data).sf
    reached = 1 - survival.probabilities
    halfway = np.flatnonzero(reached >= 0.5 - 1e-12)
    return SurvivalCurve(
        times=tuple(survival.quantiles.tolist()),
        reached=tuple(reached.tolist()),
        median=float(survival.quantiles[halfway[0]]) if len(halfway) else None,
        n=len(at),
        k=int(np.count_nonzero(is_observed)),
    )


def ratio_of_times(times: np.ndarray, others: np.ndarray) -> tuple[float, float, float]:
    """Return the ratio of two samples of times, and the ends of its 95 % interval.

    It is the median of the ratios of all pairs. The interval inverts the exact test of Mann and
    Whitney (Hodges and Lehmann 1963). It supposes that both have the same distribution but for a
    factor. Shape (seeds,) each. Times of the first may be inf, where only a lower limit is known.

    Raises:
        ValueError: there are too few times for an interval of 95 %.
    """
    n = len(times)
    ranks = combinations(range(n + len(others)), n)
    u = np.sort([sum(chosen) for chosen in ranks]) - n * (n - 1) // 2
    # The number of pairs outside of the interval on each side.
    outside = int(u[int(0.025 * len(u))])
    if outside == 0:
        raise ValueError(f"{n} and {len(others)} times are too few")
    ratios = np.sort(np.divide.outer(times, others).ravel())
    return float(np.median(ratios)), float(ratios[outside - 1]), float(ratios[-outside])

"""Learning curves: the area under one, and the time to a threshold, where runs that never reach it
are censored.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.rates import finite, wilson_interval

if TYPE_CHECKING:
    from scipy.stats import CensoredData


@dataclass(frozen=True)
class SurvivalCurve:
    """The share of runs that have reached the threshold by each of `times` (1 - S); before the
    first, none has.
    """

    times: tuple[float, ...]
    reached: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    median: float | None  # None where fewer than half have
    n: int  # runs
    k: int  # runs that have reached the threshold


def normalised_area(steps: ArrayLike, values: ArrayLike) -> float:
    """Return the area under a learning curve over the range of its steps: 1 means always at 1.

    The area is that of trapezoids between evaluations, divided by the range that they cover. NaN
    values are dropped. A single evaluation is its own area.

    Raises:
        ValueError: no evaluation is a number, or the shapes differ.
    """
    at, value = _curve(steps, values)
    at, value = at[~np.isnan(value)], value[~np.isnan(value)]
    if not len(at):
        raise ValueError("an area needs at least one evaluation that is a number")
    return float(np.trapezoid(value, at) / (at[-1] - at[0])) if len(at) > 1 else float(value[0])


def steps_to(
    steps: ArrayLike, rates: ArrayLike, threshold: float = 0.9, hold: int = 3
) -> tuple[float, bool]:
    """Return the first step from which `hold` evaluations in a row are at least `threshold`, and
    True.

    Where there is none, the run is censored at the last step from which that could have been seen,
    that of the `hold`-th evaluation from the end (0 with fewer): return that and False. `steps`,
    shape (evaluations,), rises; NaN rates are below the threshold.

    Raises:
        ValueError: there are no evaluations, or the shapes differ.
    """
    at, rate = _curve(steps, rates)
    if len(at) < hold:
        return 0.0, False
    held = np.lib.stride_tricks.sliding_window_view(rate >= threshold, hold).all(axis=1)
    return (float(at[held.argmax()]), True) if held.any() else (float(at[-hold]), False)


def kaplan_meier(times: ArrayLike, observed: ArrayLike) -> SurvivalCurve:
    """Return the product-limit estimate of the share that has reached (Kaplan & Meier 1958), at
    every distinct time.

    `times` and `observed`, shape (runs,), as `steps_to` gives them. The interval is Greenwood's on
    the log-log scale.
    Where that is undefined: before the first event it is Wilson's for none out of those at risk;
    once all have reached, the lower bound stays where it was last (with no time before, Wilson's
    for all) and the upper one is 1.

    Raises:
        ValueError: there are no runs, or a time is not finite.
    """
    from scipy import stats

    survival, n = stats.ecdf(_censored(times, observed)).sf, np.size(times)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of undefined bounds
        interval = survival.confidence_interval(method="log-log")
    at, reached = survival.quantiles, 1 - survival.probabilities
    low, high = 1 - interval.high.probabilities, 1 - interval.low.probabilities
    for i, share in enumerate(reached):
        if share == 0:
            low[i], high[i] = wilson_interval(0, int((np.asarray(times) >= at[i]).sum()))
        elif share == 1:
            low[i], high[i] = low[i - 1] if i else wilson_interval(n, n)[0], 1.0
    halfway = np.flatnonzero(reached >= 0.5 - 1e-12)
    median = float(at[halfway[0]]) if len(halfway) else None
    times_at, shares, lows, highs = (tuple(column.tolist()) for column in (at, reached, low, high))
    return SurvivalCurve(times_at, shares, lows, highs, median, n, int(np.count_nonzero(observed)))


def log_rank(a: Sequence[ArrayLike], b: Sequence[ArrayLike]) -> float | None:
    """Return the two-sided p of the log-rank test (Mantel 1966) of two pairs (times, observed);
    None without any event.

    It is 1 where the statistic has no variance, e.g. with equal times.

    Raises:
        ValueError: as `kaplan_meier`.
    """
    from scipy import stats

    if not (np.any(a[1]) or np.any(b[1])):
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.nan_to_num(stats.logrank(_censored(*a), _censored(*b)).pvalue, nan=1.0))


def _curve(steps: ArrayLike, values: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    at, value = finite(steps, "a learning curve"), np.asarray(values, dtype=float)
    if value.shape != at.shape:
        raise ValueError(
            f"{len(at)} steps and values of shape {value.shape} do not belong together"
        )
    return at, value


def _censored(times: ArrayLike, observed: ArrayLike) -> "CensoredData":
    from scipy import stats

    at, seen = finite(times, "a survival curve"), np.asarray(observed, dtype=bool)
    return stats.CensoredData(uncensored=at[seen], right=at[~seen])

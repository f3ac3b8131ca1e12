"""Time to a threshold, with runs that never reach it as censored: Kaplan-Meier, log-rank, restricted mean."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.checks import finite, finite_or_none
from parking_exp.statistics.intervals import EXACT, SCORE, Interval, score_interval
from parking_exp.statistics.rates import wilson_interval

if TYPE_CHECKING:
    from scipy.stats import CensoredData


@dataclass(frozen=True)
class SurvivalCurve:
    """The share of runs that have reached the threshold by each of `times` (1 - S); before the first, none has."""

    times: tuple[float, ...]
    reached: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    median: float | None
    n: int


def steps_to(steps: ArrayLike, rates: ArrayLike, threshold: float = 0.9, hold: int = 3) -> tuple[float, bool]:
    """Return the first step from which `hold` evaluations in a row are at least `threshold`, and True.

    Where there is none, the run is censored: the last step from which that could have been seen, which is that of the
    `hold`-th evaluation from the end (0 with fewer), and False. `steps`, shape (evaluations,), rises; NaN rates have
    not reached anything.

    Raises:
        ValueError: there are no evaluations, or the shapes differ.
    """
    at, rate = finite(steps, "a time to a threshold"), np.asarray(rates, dtype=float)
    if rate.shape != at.shape:
        raise ValueError(f"{len(at)} steps and rates of shape {rate.shape} do not belong together")
    if len(at) < hold:
        return 0.0, False
    held = np.lib.stride_tricks.sliding_window_view(rate >= threshold, hold).all(axis=1)
    return (float(at[held.argmax()]), True) if held.any() else (float(at[-hold]), False)


def kaplan_meier(times: ArrayLike, observed: ArrayLike, confidence: float = 0.95) -> SurvivalCurve:
    """Return the product-limit estimate of the share that has reached (Kaplan & Meier 1958), at every distinct time.

    `times` and `observed`, shape (runs,), as `steps_to` gives them. The interval is Greenwood's on the log-log scale.
    Where that is undefined: before the first event it is Wilson's for none out of those at risk; once all have
    reached, the lower bound stays where it was last (with no time before, Wilson's for all) and the upper one is 1.
    `median` is None where fewer than half have reached.

    Raises:
        ValueError: there are no runs, or a time is not finite.
    """
    from scipy import stats  # half a second that only reports pay

    survival = stats.ecdf(_censored(times, observed)).sf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of undefined bounds
        interval = survival.confidence_interval(confidence, method="log-log")
    at, reached = survival.quantiles, 1 - survival.probabilities
    low, high = 1 - interval.high.probabilities, 1 - interval.low.probabilities
    for i, share in enumerate(reached):
        if share == 0:
            at_risk = int((np.asarray(times) >= at[i]).sum())
            low[i], high[i] = 0.0, wilson_interval(0, at_risk, confidence)[1]
        elif share == 1:
            n = np.size(times)
            low[i], high[i] = low[i - 1] if i else wilson_interval(n, n, confidence)[0], 1.0
    halfway = np.flatnonzero(reached >= 0.5 - 1e-12)
    return SurvivalCurve(
        times=tuple(at.tolist()),
        reached=tuple(reached.tolist()),
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        median=float(at[halfway[0]]) if len(halfway) else None,
        n=np.size(times),
    )


def restricted_mean(times: ArrayLike, observed: ArrayLike, horizon: float, confidence: float = 0.95) -> Interval:
    """Return the area under S up to `horizon`: the mean time, where a run that needs longer counts as `horizon`.

    The variance is Greenwood's, sum of A_i^2 d_i / (r_i (r_i - d_i)) with A_i the area right of event i (Irwin 1949;
    Klein & Moeschberger 2003, 4.5), times n / (n - 1): without early censoring it is then the variance of a mean. The
    interval is that of `mean_interval` for few seeds (Wilson's with the effective sample size, t's quantile with n -
    1), and its exact bound where no time differs, within 0 ... `horizon`. One run has none.

    Raises:
        ValueError: as `kaplan_meier`, or a run is censored last of all and before `horizon`, so that S is unknown
        there.
    """
    at_all, seen = finite(times, "a restricted mean"), np.asarray(observed, dtype=bool)
    at, inverse = np.unique(at_all, return_inverse=True)
    events = np.bincount(inverse[seen], minlength=len(at))
    at_risk = np.array([(at_all >= time).sum() for time in at])
    n, survival = len(at_all), np.cumprod((at_risk - events) / at_risk)
    if at[-1] < horizon and survival[-1] > 0:
        raise ValueError(f"the horizon {horizon:g} lies beyond the last time that was seen, {at[-1]:g}")
    pieces = np.diff(np.concatenate([[0.0], np.minimum(at, horizon), [horizon]])) * np.concatenate([[1.0], survival])
    mean = float(pieces.sum())
    if n == 1:
        return Interval(mean, n=n)
    right = np.cumsum(pieces[::-1])[::-1][1:]
    counted = (events > 0) & (at < horizon) & (at_risk > events)
    d, r = events[counted].astype(float), at_risk[counted]
    square = float((right[counted] ** 2 * d / (r * (r - d))).sum()) * n / (n - 1)
    if square == 0:
        factor, share = ((1 - confidence) / 2) ** (1 / n), mean / horizon
        low, high, method = share * factor, 1 - (1 - share) * factor, EXACT
    else:
        bounds = score_interval(np.array(mean / horizon), np.array(square / horizon**2), n - 1, confidence)
        low, high, method = float(bounds[0]), float(bounds[1]), SCORE
    return Interval(mean, low * horizon, high * horizon, n, method)


def log_rank(a: Sequence[ArrayLike], b: Sequence[ArrayLike]) -> float | None:
    """Return the two-sided p of the log-rank test (Mantel 1966) of two pairs (times, observed); None without any event.

    Raises:
        ValueError: as `kaplan_meier`.
    """
    from scipy import stats

    if not (np.any(a[1]) or np.any(b[1])):
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        return finite_or_none(stats.logrank(_censored(*a), _censored(*b)).pvalue)


def _censored(times: ArrayLike, observed: ArrayLike) -> "CensoredData":
    from scipy import stats

    at, seen = finite(times, "a survival curve"), np.asarray(observed, dtype=bool)
    return stats.CensoredData(uncensored=at[seen], right=at[~seen])

"""Time to a threshold, with runs that never reach it as censored: Kaplan-Meier, log-rank, restricted mean."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from parking_exp.statistics.checks import confident, finite
from parking_exp.statistics.intervals import EXACT, NONE, SCORE, score_interval
from parking_exp.statistics.rates import wilson_interval


@dataclass(frozen=True)
class SurvivalCurve:
    """The share of runs that have reached the threshold by each of `times` (1 - S); before the first of them, none
    has."""

    times: tuple[float, ...]
    reached: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    at_risk: tuple[int, ...]
    events: tuple[int, ...]
    median: float | None
    n: int


@dataclass(frozen=True)
class RestrictedMean:
    """The mean of min(time, horizon), in the unit of the times."""

    mean: float
    low: float
    high: float
    error: float
    horizon: float
    n: int
    method: str


def steps_to(steps: ArrayLike, rates: ArrayLike, threshold: float = 0.9, hold: int = 3) -> tuple[float, bool]:
    """Return the first step from which `hold` evaluations in a row are at least `threshold`, and True.

    Where there is none, the run is censored: the last step from which that could have been seen, which is that of the
    `hold`-th evaluation from the end (0 with fewer), and False. `steps`, shape (evaluations,), rises; NaN rates have
    not reached anything.

    Raises:
        ValueError: there are no evaluations, the shapes differ, steps do not rise, or `hold` is below 1.
    """
    at, rate = finite(steps, "a time to a threshold"), np.asarray(rates, dtype=float)
    if rate.shape != at.shape:
        raise ValueError(f"{len(at)} steps and rates of shape {rate.shape} do not belong together")
    if (np.diff(at) <= 0).any():
        raise ValueError("the steps of evaluations must rise")
    if hold < 1:
        raise ValueError(f"a threshold is held for at least one evaluation, not {hold}")
    if len(at) < hold:
        return 0.0, False
    held = np.lib.stride_tricks.sliding_window_view(rate >= threshold, hold).all(axis=1)
    if held.any():
        return float(at[held.argmax()]), True
    return float(at[-hold]), False


def kaplan_meier(times: ArrayLike, observed: ArrayLike, confidence: float = 0.95) -> SurvivalCurve:
    """Return the product-limit estimate of the share that has reached (Kaplan & Meier 1958), at every distinct time.

    `times` and `observed`, shape (runs,), as `steps_to` gives them. The interval is Greenwood's on the log-log scale.
    Where that is undefined: before the first event it is Wilson's for none out of those at risk; once all have
    reached, the lower bound stays where it was last (with no time before, Wilson's for all) and the upper one is 1.
    `median` is None where fewer than half have reached.

    Raises:
        ValueError: there are no runs, a time is not finite or is negative, or the shapes differ.
    """
    at, at_risk, events = _counts(times, observed)
    survival, hazard = _product_limit(at_risk, events)
    z = float(ndtri(0.5 + confident(confidence) / 2))
    low, high = np.empty(len(at)), np.empty(len(at))
    for i, (share, square) in enumerate(zip(survival, hazard, strict=True)):
        if share == 1:
            low[i], high[i] = 0.0, wilson_interval(0, int(at_risk[i]), confidence)[1]
        elif share == 0:
            low[i] = low[i - 1] if i else wilson_interval(int(at_risk[0]), int(at_risk[0]), confidence)[0]
            high[i] = 1.0
        else:
            spread = z * math.sqrt(square) / abs(math.log(share))
            low[i], high[i] = 1 - share ** math.exp(-spread), 1 - share ** math.exp(spread)
    halfway = np.flatnonzero(survival <= 0.5 + 1e-12)
    return SurvivalCurve(
        times=tuple(at.tolist()),
        reached=tuple((1 - survival).tolist()),
        low=tuple(low.tolist()),
        high=tuple(high.tolist()),
        at_risk=tuple(at_risk.tolist()),
        events=tuple(events.tolist()),
        median=float(at[halfway[0]]) if len(halfway) else None,
        n=int(at_risk[0]),
    )


def restricted_mean(times: ArrayLike, observed: ArrayLike, horizon: float, confidence: float = 0.95) -> RestrictedMean:
    """Return the area under S up to `horizon`: the mean time to the threshold, where a run that needs longer counts
    as `horizon`.

    The variance is Greenwood's, sum of A_i^2 d_i / (r_i (r_i - d_i)) with A_i the area right of event i (Irwin 1949;
    Klein & Moeschberger 2003, 4.5), times n / (n - 1): without early censoring it is then the variance of a mean. The
    interval is that of `mean_interval` for few seeds (Wilson's with the effective sample size, t's quantile with n -
    1), and its exact bound where no time differs, within 0 ... `horizon`. One run has none.

    Raises:
        ValueError: as `kaplan_meier`, or a run is censored last of all and before `horizon`, so that S is unknown
        there.
    """
    at, at_risk, events = _counts(times, observed)
    n = int(at_risk[0])
    if not (math.isfinite(horizon) and horizon > 0):
        raise ValueError(f"a horizon is a positive number of steps, not {horizon}")
    survival, _ = _product_limit(at_risk, events)
    if at[-1] < horizon and survival[-1] > 0:
        raise ValueError(
            f"the horizon {horizon:g} lies beyond the last step that was seen, {at[-1]:g}; take at most that one"
        )
    knots = np.concatenate([[0.0], np.minimum(at, horizon), [horizon]])
    pieces = np.diff(knots) * np.concatenate([[1.0], survival])
    mean = float(pieces.sum())
    right = np.cumsum(pieces[::-1])[::-1][1:]
    counted = (events > 0) & (at < horizon) & (at_risk > events)
    d, r = events[counted].astype(float), at_risk[counted]
    square = float((right[counted] ** 2 * d / (r * (r - d))).sum())
    if n == 1:
        return RestrictedMean(mean, math.nan, math.nan, math.nan, horizon, n, NONE)
    square *= n / (n - 1)
    if square == 0:
        factor, share = ((1 - confident(confidence)) / 2) ** (1 / n), mean / horizon
        low, high, method = share * factor, 1 - (1 - share) * factor, EXACT
    else:
        bounds = score_interval(np.array(mean / horizon), np.array(square / horizon**2), n - 1, confident(confidence))
        low, high, method = float(bounds[0]), float(bounds[1]), SCORE
    return RestrictedMean(mean, low * horizon, high * horizon, math.sqrt(square), horizon, n, method)


def log_rank(
    a: Sequence[ArrayLike],
    b: Sequence[ArrayLike],
) -> float:
    """Return the two-sided p of the log-rank test (Mantel 1966) of two pairs (times, observed); NaN without any event.

    Raises:
        ValueError: as `kaplan_meier`.
    """
    from scipy import stats  # half a second that only reports pay

    samples = []
    for times, observed in (a, b):
        _counts(times, observed)
        at, seen = np.asarray(times, dtype=float), np.asarray(observed, dtype=bool)
        samples.append(stats.CensoredData(uncensored=at[seen], right=at[~seen]))
    if samples[0].num_censored() == len(samples[0]) and samples[1].num_censored() == len(samples[1]):
        return math.nan
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(stats.logrank(x=samples[0], y=samples[1]).pvalue)


def _counts(times: ArrayLike, observed: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the distinct times, how many runs had not reached just before each, and how many reached there."""
    at, seen = finite(times, "a survival curve"), np.asarray(observed, dtype=bool)
    if seen.shape != at.shape:
        raise ValueError(f"{len(at)} times and a flag of shape {seen.shape} do not belong together")
    if (at < 0).any():
        raise ValueError("times are not negative")
    distinct, inverse = np.unique(at, return_inverse=True)
    leaving = np.bincount(inverse, minlength=len(distinct))
    at_risk = len(at) - np.concatenate([[0], np.cumsum(leaving)[:-1]])
    return distinct, at_risk, np.bincount(inverse[seen], minlength=len(distinct))


def _product_limit(at_risk: np.ndarray, events: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return S and Greenwood's sum at every time; the sum is infinite once S is 0."""
    left = at_risk - events
    survival = np.cumprod(left / at_risk)
    with np.errstate(divide="ignore"):
        return survival, np.cumsum(events / (at_risk * left.astype(float)) * (events > 0))

"""Means of rates over training seeds, and contrasts of them, with intervals that use both levels:
seeds and episodes.

What a recipe's next seed will do is what one of the trained seeds did, or something that none of
them showed. So the mean of all possible seeds is a weighted mean of the rates of n seeds and of one
unseen seed, with weights from a Dirichlet distribution with parameters (n - 2) / n for each seed,
and UNSEEN for the unseen one: Rubin's Bayesian bootstrap (1981) with fewer seeds than there are, in
place of Student's quantile. For the lower end the unseen seed is REACH times as far below the worst
seed as that is below 100 %; for the upper end, as far above the best as REACH times its own rate
(Walley 1996: an interval of priors). Every quantile is at least as far out as that of Clopper and
Pearson's (1934) intervals of all episodes together: seeds that agree are still measured in so many
episodes only.

Raising a seed's rate never lowers an end, all cells are treated alike, at 0 and 100 % too, and
nothing is random: the same weights are used each time. `tests/support/coverage_simulation.py`
simulates how often the intervals cover.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.rates import finite

DRAWS = 20_000
UNSEEN, REACH = 0.05, 3.0  # of the unseen seed: weight and distance, chosen by simulation
KNOTS = np.linspace(-6, 6, 481)
ROUNDING = 1e-9  # how far a rate may lie outside 0 ... 1


@dataclass(frozen=True)
class SeedRates:
    """Rates of seeds in 0 ... 1, shape (seeds,).

    Attributes:
        rates: one of each seed.
        n_episodes: over how many episodes each rate was measured; None where it is no share of
            episodes.
    """

    rates: ArrayLike
    n_episodes: int | None = None


def mean_interval(rates: ArrayLike, n_episodes: int | None = None) -> Interval:
    """Return the mean of rates in 0 ... 1, shape (seeds,), with the interval of the mean of all
    possible seeds.

    One seed has no interval. `n_episodes` is that of each rate.

    Raises:
        ValueError: no rates, NaN, or rates outside 0 ... 1.
    """
    return contrast([SeedRates(rates, n_episodes)]).interval()


@dataclass(frozen=True)
class Contrast:
    """A mean of cell means, or the difference of two.

    Attributes:
        value: of the seeds that there are.
        n: seeds; of a difference, those of the side that has fewer.
        pessimistic, optimistic: draws for all possible seeds, shape (DRAWS,), with unseen seeds
            that make it low, and high; None if a cell has a single seed.
    """

    value: float
    n: int
    pessimistic: np.ndarray | None = None
    optimistic: np.ndarray | None = None

    @property
    def p(self) -> float | None:
        """Two-sided p of 0: twice the share of draws on the other side of 0, at most 1; None
        without draws.
        """
        if self.pessimistic is None or self.optimistic is None:
            return None
        not_above, not_below = (
            np.count_nonzero(self.pessimistic <= 0),
            np.count_nonzero(self.optimistic >= 0),
        )
        return float(min(1, 2 * (min(not_above, not_below) + 1) / (DRAWS + 1)))

    def interval(self, alpha: float = 0.05) -> Interval:
        """Return the interval at the level 1 - alpha; 0 lies outside exactly where p is below
        alpha.
        """
        if self.pessimistic is None or self.optimistic is None:
            return Interval(self.value, n=self.n)
        low, high = -1.0, 1.0
        if (
            rank := math.ceil(alpha / 2 * (DRAWS + 1)) - 1
        ):  # else alpha is below what so many draws resolve
            low = float(np.partition(self.pessimistic, rank - 1)[rank - 1])
            high = float(np.partition(self.optimistic, DRAWS - rank)[DRAWS - rank])
        return Interval(self.value, low, high, self.n)


def contrast(plus: Sequence[SeedRates], minus: Sequence[SeedRates] = ()) -> Contrast:
    """Return the mean of some cells' means minus that of others, if there are any."""
    weighted = [
        (cell, sign / len(side)) for side, sign in ((plus, 1), (minus, -1)) for cell in side
    ]
    rates = [finite(cell.rates, "a mean over seeds") for cell, _ in weighted]
    value = sum(
        weight * float(values.mean()) for values, (_, weight) in zip(rates, weighted, strict=True)
    )
    n = min(sum(np.size(cell.rates) for cell in side) for side in (plus, minus) if side)
    if min(map(len, rates)) == 1:
        return Contrast(value, n)
    pessimistic, optimistic = np.zeros((2, DRAWS))
    for stream, (values, (cell, weight)) in enumerate(zip(rates, weighted, strict=True)):
        order = np.random.default_rng(stream).permutation(DRAWS)  # draws of cells are independent
        low, high = (
            ends[order] for ends in _quantiles_of_mean(tuple(np.sort(values)), cell.n_episodes)
        )
        pessimistic += weight * (low if weight > 0 else high)
        optimistic += weight * (high if weight > 0 else low)
    return Contrast(value, n, pessimistic, optimistic)


@lru_cache(maxsize=64)  # a cell is compared with many others
def _quantiles_of_mean(
    rates: tuple[float, ...], n_episodes: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return DRAWS quantiles of the mean over all possible seeds, pessimistic and optimistic; the
    rates are sorted.
    """
    if rates[0] < -ROUNDING or rates[-1] > 1 + ROUNDING:
        raise ValueError("rates lie outside 0 ... 1")
    half = 0.5 / n_episodes if n_episodes else 0.0
    worst, best = max(rates[0] - half, 0.0), min(rates[-1] + half, 1.0)
    unseen = max(worst - REACH * (1 - worst), 0.0), min(best + REACH * best, 1.0)
    weights = _weights(len(rates))
    seen = weights[:, :-1] @ np.clip(rates, 0, 1)
    low, high = (
        np.sort(np.minimum(seen + weights[:, -1] * rate, 1)) for rate in unseen
    )  # in floats above 1
    if n_episodes:
        successes, trials = round(sum(rates) * n_episodes), len(rates) * n_episodes
        low = np.minimum(low, _beta_quantiles(successes, trials - successes + 1))
        high = np.maximum(high, _beta_quantiles(successes + 1, trials - successes))
    return low, high


@lru_cache(maxsize=32)
def _weights(n: int) -> np.ndarray:
    """Return weights of n sorted seeds and of the unseen one, shape (DRAWS, n + 1); two seeds count
    as 2.5.
    """
    rng = np.random.default_rng([n, 0])
    seen, unseen = (
        rng.gamma(max(n - 2, 0.5) / n, size=(DRAWS, n)),
        rng.gamma(UNSEEN, size=(DRAWS, 1)),
    )
    weights = np.concatenate([seen, unseen], axis=1)
    return weights / weights.sum(axis=1, keepdims=True)


def _beta_quantiles(a: int, b: int) -> np.ndarray:
    """Return DRAWS quantiles of a Beta distribution, in order, as Clopper and Pearson use them: 0
    if a is 0, 1 if b is.

    Interpolation over normal quantiles, in which they are nearly linear, is forty times as fast.
    """
    if not (a and b):
        return np.full(DRAWS, 0.0 if b else 1.0)
    from scipy.special import betaincinv, ndtr

    return np.interp(_normal_quantiles(), KNOTS, betaincinv(a, b, ndtr(KNOTS)))


@cache
def _normal_quantiles() -> np.ndarray:
    """Return DRAWS quantiles of the normal distribution, in order."""
    from scipy.special import ndtri

    return ndtri(np.arange(1, DRAWS + 1) / (DRAWS + 1))

"""Means of rates over training seeds, and contrasts of them.

Their intervals use both levels: seeds and episodes.

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
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.intervals import Interval

DRAWS = 20_000
UNSEEN = 0.05  # weight of the unseen seed, and
REACH = 3.0  # its distance; both were chosen by simulation
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
    """Return the mean of seeds' rates with the interval of the mean of all possible seeds.

    Rates, shape (seeds,), lie in 0 ... 1. One seed has no interval. `n_episodes` is that of each
    rate.

    Raises:
        ValueError: a rate is NaN or lies outside 0 ... 1.
    """
    return contrast([SeedRates(rates, n_episodes)]).interval()


@dataclass(frozen=True)
class Contrast:
    """A mean of cell means, or the difference of two.

    Attributes:
        value: of the seeds that there are.
        n: seeds; of a difference, those of the side that has fewer.
        draws: for all possible seeds, two of shape (DRAWS,): with unseen seeds that make it low,
            and with those that make it high; None if a cell has a single seed.
    """

    value: float
    n: int
    draws: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def p(self) -> float | None:
        """Two-sided p of 0: twice the share of draws on the other side of 0, at most 1."""
        if self.draws is None:
            return None
        pessimistic, optimistic = self.draws
        n_not_above = np.count_nonzero(pessimistic <= 0)
        n_not_below = np.count_nonzero(optimistic >= 0)
        return float(min(1, 2 * (min(n_not_above, n_not_below) + 1) / (DRAWS + 1)))

    def interval(self, alpha: float = 0.05) -> Interval:
        """Return the interval at the level 1 - alpha; it excludes 0 exactly where p is below alpha.

        Where alpha is below what so many draws resolve, it holds everything.
        """
        if self.draws is None:
            return Interval(self.value, n=self.n)

        rank = math.ceil(alpha / 2 * (DRAWS + 1)) - 1
        if rank == 0:
            return Interval(self.value, -1.0, 1.0, self.n)
        pessimistic, optimistic = self.draws
        low = np.partition(pessimistic, rank - 1)[rank - 1]
        high = np.partition(optimistic, DRAWS - rank)[DRAWS - rank]
        return Interval(self.value, float(low), float(high), self.n)


def contrast(plus: Sequence[SeedRates], minus: Sequence[SeedRates] = ()) -> Contrast:
    """Return the mean of some cells' means minus that of others, if there are any."""
    cells = [*plus, *minus]
    weights = [1 / len(plus) for _ in plus] + [-1 / len(minus) for _ in minus]
    rates = [np.asarray(cell.rates, dtype=float) for cell in cells]
    means = [float(seeds.mean()) for seeds in rates]
    value = sum(weight * mean for weight, mean in zip(weights, means, strict=True))

    n_seeds = [len(seeds) for seeds in rates]
    n = sum(n_seeds[: len(plus)])
    if minus:
        n = min(n, sum(n_seeds[len(plus) :]))
    if min(n_seeds) == 1:
        return Contrast(value, n)

    pessimistic = np.zeros(DRAWS)
    optimistic = np.zeros(DRAWS)
    for number, (cell, seeds, weight) in enumerate(zip(cells, rates, weights, strict=True)):
        low, high = _quantiles_of_mean(tuple(np.sort(seeds)), cell.n_episodes)
        if weight < 0:
            low, high = high, low
        order = np.random.default_rng(number).permutation(DRAWS)  # draws of cells are independent
        pessimistic += weight * low[order]
        optimistic += weight * high[order]
    return Contrast(value, n, (pessimistic, optimistic))


@lru_cache(maxsize=64)  # a cell is compared with many others
def _quantiles_of_mean(
    rates: tuple[float, ...], n_episodes: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return DRAWS quantiles of the mean over all possible seeds, pessimistic and optimistic.

    The rates are sorted.
    """
    is_valid = rates[0] >= -ROUNDING and rates[-1] <= 1 + ROUNDING  # not with NaN, which is last
    if not is_valid:
        raise ValueError("rates lie outside 0 ... 1")

    half_an_episode = 0.5 / n_episodes if n_episodes else 0.0
    worst = max(rates[0] - half_an_episode, 0.0)
    best = min(rates[-1] + half_an_episode, 1.0)
    unseen_low = max(worst - REACH * (1 - worst), 0.0)
    unseen_high = min(best + REACH * best, 1.0)

    weights = _weights(len(rates))
    seen = weights[:, :-1] @ np.clip(rates, 0, 1)
    unseen = weights[:, -1]
    low = np.sort(np.minimum(seen + unseen * unseen_low, 1))  # in floats, sums may exceed 1
    high = np.sort(np.minimum(seen + unseen * unseen_high, 1))
    if not n_episodes:
        return low, high

    successes = round(sum(rates) * n_episodes)
    failures = len(rates) * n_episodes - successes
    low = np.minimum(low, _beta_quantiles(successes, failures + 1))
    high = np.maximum(high, _beta_quantiles(successes + 1, failures))
    return low, high


@lru_cache(maxsize=32)
def _weights(n: int) -> np.ndarray:
    """Return weights of n sorted seeds and of the unseen one, shape (DRAWS, n + 1).

    Two seeds count as 2.5.
    """
    rng = np.random.default_rng([n, 0])
    seen = rng.gamma(max(n - 2, 0.5) / n, size=(DRAWS, n))
    unseen = rng.gamma(UNSEEN, size=(DRAWS, 1))
    weights = np.concatenate([seen, unseen], axis=1)
    return weights / weights.sum(axis=1, keepdims=True)


def _beta_quantiles(a: int, b: int) -> np.ndarray:
    """Return DRAWS quantiles of a Beta distribution, in order: all 0 if a is 0, all 1 if b is.

    Clopper and Pearson use them so. Interpolation over normal quantiles, in which they are nearly
    linear, is much faster than their exact computation.
    """
    if a == 0:
        return np.zeros(DRAWS)
    if b == 0:
        return np.ones(DRAWS)
    from scipy.special import betaincinv, ndtr, ndtri

    normal_quantiles = ndtri(np.arange(1, DRAWS + 1) / (DRAWS + 1))
    return np.interp(normal_quantiles, KNOTS, betaincinv(a, b, ndtr(KNOTS)))

"""Means of rates over training seeds, with intervals that use both levels: seeds and episodes.

The next seed of a recipe will behave like one of the trained seeds, or like none of them. So the
mean of all possible seeds is a weighted mean of the rates of n seeds and of one unseen seed. The
weights have a Dirichlet distribution. Its parameters are (n - 2) / n for each seed, and UNSEEN for
the unseen one. This is Rubin's Bayesian bootstrap (1981), but it counts fewer seeds than there
are, in place of Student's quantile.

For the lower end, the unseen seed lies below the worst seed by the smaller of

- REACH times the distance of the worst seed from 100 %,
- SPREAD times the range of the seeds, or NEAR if that is larger.

The upper end is the same seen from 0 % (Walley 1996: an interval of priors).

Every end is at least as far out as the end of Clopper and Pearson's (1934) interval of all episodes
together, because seeds that agree were still measured over a limited number of episodes.

Nothing is random. `tests/support/coverage_simulation.py` simulates how often intervals cover.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.intervals import Interval

# Weight of the unseen seed, and limits of its distance; all were chosen by simulation.
UNSEEN = 0.05
REACH = 3.0
SPREAD = 4.0
NEAR = 0.1
ROUNDING = 1e-9  # how far a rate may lie outside 0 ... 1


@dataclass(frozen=True)
class SeedRates:
    """Rates of seeds in 0 ... 1, shape (seeds,).

    Attributes:
        rates: one of each seed.
        n_episodes: over how many episodes each rate was measured; None where it is not a share of
            episodes.
    """

    rates: ArrayLike
    n_episodes: int | None = None


def mean_interval(rates: ArrayLike, n_episodes: int | None = None, alpha: float = 0.05) -> Interval:
    """Return the mean of seeds' rates with the interval of the mean of all possible seeds.

    Rates, shape (seeds,), lie in 0 ... 1, each over `n_episodes` episodes. One seed has no
    interval. The interval is at the level 1 - alpha.

    Raises:
        ValueError: a rate is NaN or lies outside 0 ... 1.
    """
    seeds = np.sort(np.asarray(rates, dtype=float))
    is_valid = seeds[0] >= -ROUNDING and seeds[-1] <= 1 + ROUNDING  # not with NaN, which is last
    if not is_valid:
        raise ValueError("rates lie outside 0 ... 1")

    value = float(seeds.mean())
    if len(seeds) == 1:
        return Interval(value, n=1)
    seeds = np.clip(seeds, 0, 1)
    low = _lower_end(tuple(seeds), n_episodes, alpha)
    high = 1 - _lower_end(tuple(1 - seeds[::-1]), n_episodes, alpha)
    return Interval(value, low, high, len(seeds))


@lru_cache(maxsize=256)  # a cell is compared with many others
def _lower_end(seeds: tuple[float, ...], n_episodes: int | None, alpha: float) -> float:
    """Return the lower end of the interval of the mean of rates, which are in order."""
    half_an_episode = 0.5 / n_episodes if n_episodes else 0.0
    worst = max(seeds[0] - half_an_episode, 0.0)
    best = min(seeds[-1] + half_an_episode, 1.0)
    farthest = max(SPREAD * (best - worst), NEAR)
    unseen = max(worst - min(REACH * (1 - worst), farthest), 0.0)

    n = len(seeds)
    weight = max(n - 2, 0.5) / n  # two seeds count as 2.5
    end = _quantile(
        alpha / 2, np.array([unseen, *seeds]), weights=np.array([UNSEEN, *[weight] * n])
    )
    if n_episodes is None:
        return end
    successes = round(sum(seeds) * n_episodes)
    return min(end, _clopper_pearson_lower(successes, n * n_episodes, alpha))


def _clopper_pearson_lower(successes: int, trials: int, alpha: float) -> float:
    from scipy.special import betaincinv

    if successes == 0:
        return 0.0
    return float(betaincinv(successes, trials - successes + 1, alpha / 2))


def _quantile(probability: float, values: np.ndarray, weights: np.ndarray) -> float:
    """Return a quantile of the mean of values weighted by Dirichlet(weights), shape (n,) each."""
    from scipy.optimize import brentq

    lowest = float(values.min())
    highest = float(values.max())
    if highest - lowest < ROUNDING:
        return lowest

    def excess(mean: float) -> float:
        return _probability_below(mean, values, weights) - probability

    inside = ROUNDING * (highest - lowest)  # the integral has no value at the ends themselves
    if excess(lowest + inside) >= 0:
        return lowest
    return float(brentq(excess, lowest + inside, highest - inside, xtol=1e-9))


def _probability_below(mean: float, values: np.ndarray, weights: np.ndarray) -> float:
    """Return the probability that the weighted mean is below a number.

    A weighted mean is below it where a weighted sum of Gamma variables is negative: Gil-Pelaez's
    integral (1951) of the characteristic function of that sum, over the logarithm of its argument.
    """
    distances = values - mean
    distances = distances / np.abs(distances).max()
    total = weights.sum()
    step = 0.4 / math.sqrt(max(total, 4))  # resolves the phase; half of it changes no end by 1e-5
    log_argument = np.arange(-25, 25 + 25 / total, step)
    angles = np.outer(np.exp(log_argument), distances)
    log_modulus = -0.5 * np.log1p(angles**2) @ weights
    phase = np.arctan(angles) @ weights
    integral = np.sum(np.exp(log_modulus) * np.sin(phase)) * step
    return float(0.5 - integral / np.pi)

"""Simulate the coverage of confidence intervals.

A seed's true rate is drawn from a Beta distribution, or is 0 if the seed collapses; its measured rate is over 100 scenes.
`python tests/support/coverage_simulation.py` prints the whole table.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import stats

from parking_exp.statistics import coverage_note, restricted_mean
from parking_exp.statistics.comparisons import newcombe
from parking_exp.statistics.intervals import interval_rows

DRAWS = 2000
SCENES = 100
SEEDS = (3, 5, 10, 20, 30)


@dataclass(frozen=True)
class Rates:
    """Seeds whose true rates have this mean and deviation; the share `failing` of them is at 0 instead."""

    mean: float
    deviation: float
    failing: float = 0.0

    def measured(self, n, draws=DRAWS, seed=1):
        rng = np.random.default_rng(seed)
        size = self.mean * (1 - self.mean) / self.deviation**2 - 1
        rates = rng.beta(self.mean * size, (1 - self.mean) * size, (draws, n))
        if self.failing:
            rates = np.where(rng.random((draws, n)) < self.failing, 0.0, rates)
        return rng.binomial(SCENES, rates) / SCENES


DEVIATIONS = {
    0.25: (0.05, 0.15),
    0.5: (0.05, 0.15),
    0.75: (0.05, 0.15),
    0.9: (0.03, 0.08, 0.15),
    0.95: (0.03, 0.06, 0.1),
    0.99: (0.01, 0.03),
}
HEALTHY = tuple(Rates(mean, deviation) for mean, deviations in DEVIATIONS.items() for deviation in deviations)
COLLAPSING = tuple(Rates(*rates, failing) for rates in ((0.95, 0.03), (0.8, 0.08)) for failing in (0.1, 0.2))
PAIRS = (
    (Rates(0.5, 0.15), Rates(0.5, 0.15)),
    (Rates(0.5, 0.05), Rates(0.5, 0.15)),
    (Rates(0.75, 0.05), Rates(0.9, 0.03)),
    (Rates(0.9, 0.08), Rates(0.75, 0.05)),
    (Rates(0.95, 0.06), Rates(0.25, 0.05)),
    (Rates(0.95, 0.06), Rates(0.95, 0.06)),
    (Rates(0.99, 0.03), Rates(0.75, 0.15)),
    (Rates(0.99, 0.03), Rates(0.99, 0.03)),
)
SKEWED_PAIRS = (
    (Rates(0.9, 0.15), Rates(0.5, 0.05)),
    (Rates(0.99, 0.03), Rates(0.95, 0.06)),
    (Rates(0.95, 0.1), Rates(0.99, 0.01)),
)
RESTRICTED = ((20, 0.2, 0.0), (20, 0.5, 0.0), (40, 0.5, 0.0), (30, 0.3, 0.1), (30, 0.3, 0.2))


def of_mean(rates, n, draws=DRAWS):
    """Return in which of the draws `mean_interval` holds the mean of all seeds."""
    low, high, _ = interval_rows(rates.measured(n, draws), 1999)
    truth = rates.mean * (1 - rates.failing)
    return (low <= truth) & (truth <= high)


def of_difference(a, b, n, draws=DRAWS):
    """Return in which of the draws Welch's interval holds the difference."""
    first, second = a.measured(n, draws, seed=2), b.measured(n, draws, seed=3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # draws without scatter
        interval = stats.ttest_ind(first, second, axis=1, equal_var=False).confidence_interval()
    return (np.nan_to_num(interval.low) <= a.mean - b.mean) & (a.mean - b.mean <= np.nan_to_num(interval.high))


def of_improvement(a, b, n, draws=DRAWS):
    """Return in which of the draws Newcombe's interval holds the probability that a measured seed of a beats one of b."""
    counts = [
        np.bincount(np.rint(SCENES * side.measured(1, 400_000, seed)[:, 0]).astype(int), minlength=SCENES + 1) / 400_000
        for side, seed in ((a, 4), (b, 5))
    ]
    truth = (counts[0] * (np.cumsum(counts[1]) - counts[1] / 2)).sum()
    first, second = a.measured(n, draws, seed=2), b.measured(n, draws, seed=3)
    theta = (1 + np.sign(first[:, :, None] - second[:, None])).mean(axis=(1, 2)) / 2
    low, high = np.transpose([newcombe(value, n, n) for value in theta])
    return (low <= truth) & (truth <= high)


def of_restricted_mean(median, deviation, failing, n, draws=DRAWS):
    """Return in which of the draws the restricted mean's interval holds: log-normal times in thousands of steps, horizon 50.

    Times are seen on a grid of 2.5; the share `failing` never reaches.
    """
    horizon = 50.0

    def times(rng, shape):
        drawn = np.ceil(np.exp(rng.normal(np.log(median), deviation, shape)) / 2.5) * 2.5
        return np.where(rng.random(shape) < failing, 1000.0, drawn)

    truth = np.minimum(times(np.random.default_rng(7), 400_000), horizon).mean()
    hits = []
    for time in times(np.random.default_rng(8), (draws, n)):
        estimate = restricted_mean(np.minimum(time, horizon), time <= horizon, horizon)
        hits.append(estimate.low <= truth <= estimate.high)
    return np.array(hits)


def speaks(a, n, b=None, draws=400):
    """Return in which of the draws `coverage_note` says something."""
    sides = [a.measured(n, draws, seed=2)] + ([b.measured(n, draws, seed=3)] if b else [])
    return np.array([coverage_note(*rows) is not None for rows in zip(*sides, strict=True)])


def main():
    """Print the coverage of everything, in percent, by number of seeds."""
    print("seeds", *SEEDS)
    tables = (
        ("mean", of_mean, [(rates,) for rates in HEALTHY + COLLAPSING]),
        ("difference", of_difference, PAIRS + SKEWED_PAIRS),
        ("improvement", of_improvement, PAIRS + SKEWED_PAIRS),
        ("note speaks", lambda a, b, n: speaks(a, n, b), PAIRS + SKEWED_PAIRS),
        ("restricted mean", of_restricted_mean, RESTRICTED),
    )
    for name, coverage, populations in tables:
        for population in populations:
            print(name, *population, *(f"{100 * coverage(*population, n).mean():.1f}" for n in SEEDS))


if __name__ == "__main__":
    main()

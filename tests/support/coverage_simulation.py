"""Simulate the coverage of confidence intervals.

A seed's true rate is drawn from a Beta distribution, or is 0 if the seed collapses; its measured rate is over 100 scenes.
`python tests/support/coverage_simulation.py` prints the whole table.
"""

import warnings
from dataclasses import dataclass

import numpy as np
from scipy import stats

from parking_exp.statistics import coverage_note
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


def speaks(rates, n, draws=400):
    """Return in which of the draws `coverage_note` says something."""
    return np.array([coverage_note(row) is not None for row in rates.measured(n, draws, seed=2)])


def main():
    """Print the coverage of everything, in percent, by number of seeds."""
    print("seeds", *SEEDS)
    tables = (
        ("mean", of_mean, [(rates,) for rates in HEALTHY + COLLAPSING]),
        ("difference", of_difference, PAIRS + SKEWED_PAIRS),
        ("improvement", of_improvement, PAIRS + SKEWED_PAIRS),
        ("note speaks", speaks, [(rates,) for rates in COLLAPSING]),
    )
    for name, coverage, populations in tables:
        for population in populations:
            print(name, *population, *(f"{100 * coverage(*population, n).mean():.1f}" for n in SEEDS))


if __name__ == "__main__":
    main()

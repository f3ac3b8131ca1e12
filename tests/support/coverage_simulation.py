"""Simulate how often intervals cover, and how often the test errs, by number of seeds.

A seed's true rate is drawn from a Beta distribution, or is 0 if the seed collapses; its measured
rate is over 100 or 500 episodes. `PYTHONPATH=. python tests/support/coverage_simulation.py` prints
the whole table.
"""

from dataclasses import dataclass

import numpy as np

from parking_exp.reports.cell_comparisons import judge
from parking_exp.statistics import SeedRates, compare, mean_interval
from parking_exp.statistics.permutation import permutation_p

DRAWS = 2000
EPISODES = (100, 500)
SEEDS = (5, 10, 20)


@dataclass(frozen=True)
class Rates:
    """Seeds whose true rates have this mean and deviation; the share `failing` of them is at 0
    instead.
    """

    mean: float
    deviation: float = 0.0
    failing: float = 0.0

    @property
    def truth(self):
        return self.mean * (1 - self.failing)

    def measured(self, n, draws=DRAWS, seed=1, episodes=100):
        rng = np.random.default_rng(seed)
        rates = np.full((draws, n), self.mean)
        if self.deviation:
            size = self.mean * (1 - self.mean) / self.deviation**2 - 1
            rates = rng.beta(self.mean * size, (1 - self.mean) * size, (draws, n))
        if self.failing:
            rates = np.where(rng.random((draws, n)) < self.failing, 0.0, rates)
        return rng.binomial(episodes, rates) / episodes


DEVIATIONS = {
    0.25: (0.05, 0.15),
    0.5: (0.05, 0.15, 0.3),
    0.75: (0.05, 0.15),
    0.9: (0.03, 0.08),
    0.95: (0.03,),
    0.98: (0.015,),
    0.99: (0, 0.005, 0.01),
    0.995: (0.005,),
    0.999: (0.001,),
    0.9999: (0,),
}
LEVELS = (0.05, 0.005, 0.0011)
HEALTHY = tuple(
    Rates(mean, deviation) for mean, deviations in DEVIATIONS.items() for deviation in deviations
)
# A few seeds are far below the others: one in a hundred below 0.33, 0.73, 0.51 and 0.85.
TAILED = (Rates(0.9, 0.15), Rates(0.95, 0.06), Rates(0.95, 0.1), Rates(0.99, 0.03))
COLLAPSING = tuple(
    Rates(*rates, failing) for rates in ((0.95, 0.03), (0.8, 0.08)) for failing in (0.1, 0.2)
)
# With so few collapses, most seeds that are trained show none.
RARELY_COLLAPSING = (Rates(0.99, 0.01, failing=0.05), Rates(0.99, 0.01, failing=0.1))
PAIRS = (
    (Rates(0.5, 0.15), Rates(0.5, 0.15)),
    (Rates(0.5, 0.05), Rates(0.5, 0.15)),
    (Rates(0.75, 0.05), Rates(0.9, 0.03)),
    (Rates(0.9, 0.08), Rates(0.9, 0.08)),
    (Rates(0.95, 0.06), Rates(0.25, 0.05)),
    (Rates(0.95, 0.06), Rates(0.95, 0.06)),
    (Rates(0.99, 0.01), Rates(0.99, 0.01)),
    (Rates(0.999, 0.001), Rates(0.999, 0.001)),
    (Rates(0.999, 0.001), Rates(0.99, 0.01)),
)
SKEWED_PAIRS = (
    (Rates(0.9, 0.15), Rates(0.5, 0.05)),
    (Rates(0.95, 0.1), Rates(0.99, 0.01)),
    (Rates(0.99, 0.03), Rates(0.99, 0.03)),
    (Rates(0.9999), Rates(0.9, 0.08)),
)


# Pairs of equal cells: healthy, at the ceiling, and with seeds that collapse; and of unequal ones.
EQUAL = tuple(
    (rates, rates)
    for rates in (
        Rates(0.9, 0.08),
        Rates(0.999, 0.001),
        Rates(0.99, 0.01, failing=0.05),
        Rates(0.99, 0.01, failing=0.1),
    )
)
UNEQUAL = (
    (Rates(0.9, 0.03), Rates(0.95, 0.03)),
    (Rates(0.98, 0.015), Rates(0.995, 0.005)),
    (Rates(0.99, 0.01, failing=0.1), Rates(0.99, 0.01)),
    (Rates(0.8, 0.08), Rates(0.95, 0.03)),
)
# A verdict needs the test and the interval, and the interval of a family is wider.
FAMILIES = (1, 10, 20)
APART = (
    (Rates(0.4, 0.05), Rates(0.5, 0.05)),
    (Rates(0.4, 0.05), Rates(0.6, 0.05)),
    (Rates(0.9, 0.03), Rates(0.95, 0.03)),
    (Rates(0.8, 0.08), Rates(0.95, 0.03)),
)
# Their means are equal. Their distributions are not, which the test takes them to be.
OF_OTHER_SHAPES = (
    (Rates(0.99, 0.003), Rates(0.99, 0.03)),
    (Rates(0.9405, 0.01), Rates(0.99, 0.01, failing=0.05)),
    (Rates(0.891, 0.01), Rates(0.99, 0.01, failing=0.1)),
)


def of_mean(rates, n, draws=DRAWS, episodes=100):
    """Return in which of the draws `mean_interval` holds the mean of all seeds."""
    intervals = [
        mean_interval(row, episodes) for row in rates.measured(n, draws, episodes=episodes)
    ]
    return np.array([interval.low <= rates.truth <= interval.high for interval in intervals])


def differences(a, b, n, draws, episodes, alpha=0.05, n_pairs=1):
    """Return what `compare` says of a pair in each of the draws."""
    first = a.measured(n, draws, 2, episodes)
    second = b.measured(n, draws, 3, episodes)
    compared = []
    for row_a, row_b in zip(first, second, strict=True):
        pair = ([SeedRates(row_a, episodes)], [SeedRates(row_b, episodes)])
        compared += compare([pair], alpha, n_pairs)
    return compared


def of_difference(a, b, n, draws=DRAWS, episodes=100, alpha=0.05):
    """Return in which of the draws the interval of `compare` at the level 1 - alpha holds the
    difference.
    """
    truth = a.truth - b.truth
    compared = differences(a, b, n, draws, episodes, alpha)
    return np.array([difference.low <= truth <= difference.high for difference in compared])


def p_values(a, b, n, draws=DRAWS, episodes=100):
    """Return the p of `compare` in each of the draws, for a test of its levels or of its power."""
    first = a.measured(n, draws, 2, episodes)
    second = b.measured(n, draws, 3, episodes)
    return np.array(
        [permutation_p([(row_a, row_b)]) for row_a, row_b in zip(first, second, strict=True)]
    )


def decides(a, b, n, n_pairs=1, draws=500, episodes=500, verdicts=("a", "b")):
    """Return in which of the draws a report has one of the verdicts, of a pair of `n_pairs`.

    The default is "better" and "worse".
    """
    compared = differences(a, b, n, draws, episodes, n_pairs=n_pairs)
    return np.array([judge(difference) in verdicts for difference in compared])


def main():
    """Print how often the test finds a difference, and how often intervals cover.

    Shares are in percent, by number of seeds. Coverage is with 100 and with 500 episodes.
    """
    print("share of draws with p at or below", *LEVELS, "by number of seeds", *SEEDS)
    for name, pairs in (("equal", EQUAL), ("unequal", UNEQUAL)):
        for pair in pairs:
            p = [p_values(*pair, n, 10_000) for n in SEEDS]
            shares = [[f"{100 * (of_n <= level).mean():.2f}" for level in LEVELS] for of_n in p]
            print(name, *pair, *map("/".join, shares), flush=True)

    print("share of draws with a verdict, by number of seeds", *SEEDS, "and of pairs", *FAMILIES)
    for name, pairs in (("unequal", APART), ("equal means", OF_OTHER_SHAPES)):
        for pair in pairs:
            shares = [
                [f"{100 * decides(*pair, n, n_pairs).mean():.1f}" for n_pairs in FAMILIES]
                for n in SEEDS
            ]
            print(name, *pair, *map("/".join, shares), flush=True)

    print("share of draws that are unclear, of a single pair, by number of seeds", *SEEDS)
    for pair in EQUAL:
        unclear = [decides(*pair, n, verdicts=("unclear",)) for n in SEEDS]
        print("equal", *pair, *(f"{100 * of_n.mean():.1f}" for of_n in unclear), flush=True)

    print("coverage, by number of seeds", *SEEDS)
    of_one = HEALTHY + TAILED + COLLAPSING + RARELY_COLLAPSING
    tables = (
        ("mean", of_mean, [(rates,) for rates in of_one]),
        ("difference", of_difference, PAIRS + SKEWED_PAIRS),
    )
    for name, coverage, populations in tables:
        for population in populations:
            covered = [
                [coverage(*population, n, episodes=m).mean() for n in SEEDS] for m in EPISODES
            ]
            print(
                name,
                *population,
                *("/".join(f"{100 * share:.1f}" for share in row) for row in covered),
                flush=True,
            )


if __name__ == "__main__":
    main()

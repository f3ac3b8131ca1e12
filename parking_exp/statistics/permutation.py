"""The exact permutation test of the difference of two means."""

import itertools
import math
from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

MAX_EPISODES = 10_000  # of a rate
RATE_STEPS = 20_000  # rates that are no shares of so many episodes are rounded to 0.005 points
MAX_DIFFERENCE_STEPS = 200_000  # in a difference of 1
MAX_COUNTS = 20_000_000  # of sums: with more, rates are rounded further, to fit into memory


def permutation_p(strata: Sequence[tuple[ArrayLike, ArrayLike]]) -> float:
    """Return the two-sided p of the difference of two means, summed over strata (Fisher 1935).

    It is the share of all assignments of the seeds of each stratum to its two cells in which the
    difference is at least as far from 0. Whatever the distribution of the seeds, equal cells have a
    p of at most x with a probability of at most x. Swapping the cells does not change it.

    Args:
        strata: pairs of rates in 0 ... 1, shapes (n_a,) and (n_b,). Shares of up to MAX_EPISODES
            episodes are exact, others are rounded.
    """
    from scipy.signal import fftconvolve

    cells = [*itertools.chain(*strata)]
    rate_steps = _choose_rate_steps(np.concatenate(cells))
    # All differences are multiples of such a step, unless cells have many different sizes.
    n_steps = rate_steps * math.lcm(*map(np.size, cells))
    n_steps = min(n_steps, MAX_DIFFERENCE_STEPS)

    observed = 0
    shares = np.ones(1)
    for a, b in strata:
        observed_in_stratum, shares_in_stratum = _share_differences(a, b, rate_steps, n_steps)
        observed += observed_in_stratum
        shares = fftconvolve(shares, shares_in_stratum)

    differences = np.arange(len(shares)) - len(shares) // 2
    as_far = np.abs(differences) >= abs(observed)
    p = math.fsum(shares[as_far])
    return min(1.0, max(0.0, p))  # the convolution is not exact to the last digit


def _choose_rate_steps(rates: np.ndarray) -> int:
    """Return the smallest number of which all rates are whole parts, else RATE_STEPS.

    Equal sums have to stay equal. With 300 episodes, rates that were rounded would break ties.
    """
    shares = [Fraction(rate).limit_denominator(MAX_EPISODES) for rate in rates]
    n_steps = math.lcm(*[share.denominator for share in shares])
    are_shares = np.allclose(rates, np.array(shares, dtype=float), rtol=0, atol=1e-12)
    if are_shares and n_steps <= MAX_DIFFERENCE_STEPS:
        return n_steps
    return RATE_STEPS


def _share_differences(
    a: ArrayLike, b: ArrayLike, rate_steps: int, n_steps: int
) -> tuple[int, np.ndarray]:
    """Return the observed difference, and the share of the assignments that have each difference.

    Rates are rounded to 1 / rate_steps, differences to 1 / n_steps. The shares are those of the
    differences -d, ..., 0, ..., d.
    """
    if np.size(a) > np.size(b):  # fewer sums are counted for the smaller cell
        observed, shares = _share_differences(b, a, rate_steps, n_steps)
        return -observed, shares[::-1]

    n_a = np.size(a)
    n_b = np.size(b)
    both = np.rint(np.concatenate([a, b]) * rate_steps).astype(int)
    above_lowest = both - both.min()
    step = np.gcd.reduce(above_lowest)  # e.g. 40 for rates of 500 episodes
    step = max(step, math.ceil(above_lowest.sum() * n_a / MAX_COUNTS), 1)
    seeds = above_lowest // step
    total = seeds.sum()
    sums_of_a = np.arange(total + 1)
    differences_of_means = sums_of_a / n_a - (total - sums_of_a) / n_b
    differences = np.rint(differences_of_means * step / rate_steps * n_steps).astype(int)

    farthest = np.abs(differences).max()
    shares = np.bincount(
        differences + farthest, weights=_share_sums(seeds, n_a), minlength=2 * farthest + 1
    )
    observed = differences[seeds[:n_a].sum()]
    return int(observed), shares


def _share_sums(seeds: np.ndarray, size: int) -> np.ndarray:
    """Return the share of the subsets of a size that have each sum, shape (sum of all + 1,).

    Subsets are counted by a recursion over the seeds (Pagano & Tritchler 1983).
    """
    total = seeds.sum()
    counts = np.zeros((size + 1, total + 1))  # by number of seeds taken, and by their sum
    counts[0, 0] = 1
    highest = 0
    for n_seen, seed in enumerate(np.sort(seeds)):
        for taken in range(min(n_seen + 1, size), 0, -1):
            counts[taken, seed : seed + highest + 1] += counts[taken - 1, : highest + 1]
        highest += seed
        counts[:, : highest + 1] /= 2  # keeps them finite for hundreds of seeds
    return counts[size] / counts[size].sum()

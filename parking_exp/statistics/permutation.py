"""The exact permutation test of the difference of two means."""

import itertools
import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

MAX_EPISODES = 10_000  # most episodes of a rate for which p is exact
MAX_RATE_STEPS = 10**9  # keeps sums within 64 bits where seeds have different numbers of episodes
RATE_STEPS = 20_000  # other rates are rounded to 0.005 points
MAX_SUMMED_STEPS = 2_000_000  # in all strata: a sum of 20 strata then takes seconds
MAX_COUNTS = 20_000_000  # with more sums, rates are rounded further, to fit into memory


class _Assignments(NamedTuple):
    """The differences of means in all assignments of seeds to two cells.

    Attributes:
        observed: the difference in the assignment that was made.
        differences: all possible ones, in the same unit, shape (n,).
        shares: of the assignments that have each difference, shape (n,).
    """

    observed: float
    differences: np.ndarray
    shares: np.ndarray


def permutation_p(strata: Sequence[tuple[ArrayLike, ArrayLike]]) -> float:
    """Return the two-sided p of the difference of two means, summed over strata (Fisher 1935).

    The seeds of each stratum are assigned to its two cells in all ways. p is the share of the
    assignments whose difference is at least as far from 0 as the observed one. If the cells are
    equal, p is at most x with a probability of at most x, whatever the distribution of the seeds.
    Swapping the cells does not change p.

    With one stratum, p is exact if rates are shares of at most MAX_EPISODES episodes and all sums
    fit into memory. With several, it is exact if the number of strata, times the number of
    episodes, times the least common multiple of the cells' sizes is at most MAX_SUMMED_STEPS.

    Args:
        strata: pairs of rates in 0 ... 1, shapes (n_a,) and (n_b,).
    """
    cells = [*itertools.chain(*strata)]
    rate_steps = _choose_rate_steps(np.concatenate(cells))
    assignments = [_assign(a, b, rate_steps) for a, b in strata]
    total = assignments[0]
    if len(assignments) > 1:
        n_steps = rate_steps * math.lcm(*map(np.size, cells))
        total = _add(assignments, min(n_steps, MAX_SUMMED_STEPS // len(strata)))

    as_far = np.abs(total.differences) >= abs(total.observed)
    p = math.fsum(total.shares[as_far])
    return min(1.0, max(0.0, p))  # sums of shares are not exact to the last digit


def _choose_rate_steps(rates: np.ndarray) -> int:
    """Return the smallest n for which all rates are multiples of 1 / n, else RATE_STEPS.

    Equal sums have to stay equal. With 300 episodes, rates that were rounded would break ties.
    """
    shares = [Fraction(rate).limit_denominator(MAX_EPISODES) for rate in rates]
    are_shares = np.allclose(rates, np.array(shares, dtype=float), rtol=0, atol=1e-12)
    n_steps = math.lcm(*[share.denominator for share in shares])
    if are_shares and n_steps <= MAX_RATE_STEPS:
        return n_steps
    return RATE_STEPS


def _assign(a: ArrayLike, b: ArrayLike, rate_steps: int) -> _Assignments:
    """Assign the seeds of two cells in all ways, with rates rounded to 1 / rate_steps."""
    if np.size(a) > np.size(b):  # fewer sums are counted for the smaller cell
        swapped = _assign(b, a, rate_steps)
        return _Assignments(-swapped.observed, -swapped.differences, swapped.shares)

    n_a = np.size(a)
    n_b = np.size(b)
    both = np.rint(np.concatenate([a, b]) * rate_steps).astype(int)
    below_highest = both.max() - both  # small where few seeds collapse
    step = max(int(np.gcd.reduce(below_highest)), 1)  # e.g. 40 for rates of 500 episodes
    step *= max(math.ceil(below_highest.sum() / step * n_a / MAX_COUNTS), 1)
    seeds = np.rint(below_highest / step).astype(int)
    total = seeds.sum()
    sums_of_a = np.arange(total + 1)
    # Whole numbers are divided last, so that equal distances from 0 stay equal.
    differences = step * (total * n_a - sums_of_a * (n_a + n_b)) / (rate_steps * n_a * n_b)
    observed = differences[seeds[:n_a].sum()]
    return _Assignments(observed, differences, _share_sums(seeds, n_a))


def _add(assignments: list[_Assignments], n_steps: int) -> _Assignments:
    """Add the differences of strata, as whole numbers of steps of 1 / n_steps."""
    from scipy.signal import fftconvolve

    observed = 0
    shares = np.ones(1)
    for stratum in assignments:
        differences = np.rint(stratum.differences * n_steps).astype(int)
        farthest = np.abs(differences).max()
        shares_in_stratum = np.bincount(
            differences + farthest, weights=stratum.shares, minlength=2 * farthest + 1
        )
        shares = fftconvolve(shares, shares_in_stratum)
        observed += round(stratum.observed * n_steps)

    differences = np.arange(len(shares)) - len(shares) // 2
    return _Assignments(observed, differences, shares)


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

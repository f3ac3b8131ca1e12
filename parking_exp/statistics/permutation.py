"""The exact permutation test of the difference of two means."""

import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

RATE_STEPS = 1_000  # rates are rounded to 0.1 points
FINEST = 1_000_000  # steps of differences


def permutation_p(strata: Sequence[tuple[ArrayLike, ArrayLike]]) -> float:
    """Return the two-sided p of the difference of two means, summed over strata (Fisher 1935).

    It is the share of all assignments of the seeds of each stratum to its two cells in which the
    difference is at least as far from 0. Whatever the distribution of the seeds, equal cells have a
    p of at most x with a probability of at most x. Swapping the cells does not change it.

    Args:
        strata: pairs of rates in 0 ... 1, shapes (n_a,) and (n_b,).
    """
    from scipy.signal import fftconvolve

    sizes = [np.size(rates) for pair in strata for rates in pair]
    n_steps = min(RATE_STEPS * math.lcm(*sizes), FINEST)
    assigned = [_assign(np.asarray(a), np.asarray(b), n_steps) for a, b in strata]
    observed = sum(difference for difference, _ in assigned)
    shares = functools.reduce(fftconvolve, [shares for _, shares in assigned])

    differences = np.arange(len(shares)) - len(shares) // 2
    as_far = np.abs(differences) >= abs(observed)
    return min(1.0, math.fsum(shares[as_far]))


def _assign(a: np.ndarray, b: np.ndarray, n_steps: int) -> tuple[int, np.ndarray]:
    """Return the observed difference, and the share of the assignments that have each difference.

    Differences are in 1 / n_steps. The shares are those of -d, ..., 0, ..., d.
    """
    in_steps = np.rint(np.concatenate([a, b]) * RATE_STEPS).astype(int)
    above_lowest = in_steps - in_steps.min()
    # 500 episodes need every other step only. Hundreds of seeds are rounded further: the table of
    # their sums has to fit into memory.
    step = max(np.gcd.reduce(above_lowest), len(above_lowest) // 200, 1)
    seeds = above_lowest // step
    total = seeds.sum()
    sums_of_a = np.arange(total + 1)
    of_means = sums_of_a / len(a) - (total - sums_of_a) / len(b)
    differences = np.rint(of_means * step / RATE_STEPS * n_steps).astype(int)

    farthest = np.abs(differences).max()
    shares = np.bincount(
        differences + farthest, weights=_share_sums(seeds, len(a)), minlength=2 * farthest + 1
    )
    observed = differences[seeds[: len(a)].sum()]
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

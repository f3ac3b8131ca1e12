"""Proportions with intervals: of the episodes of a run, of the seeds of a cell."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri  # scipy.stats takes half a second to import, and every run needs this

from parking_exp.statistics.checks import finite


@dataclass(frozen=True)
class Proportion:
    """`k` of `n`, with an interval of the share; None without data."""

    k: int
    n: int
    low: float | None
    high: float | None


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return Wilson's score interval of a rate (Wilson 1927).

    Raises:
        ValueError: `trials` is not positive, or `successes` lies outside 0 ... `trials`.
    """
    if trials < 1:
        raise ValueError("a rate needs at least one trial")
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} of {trials} is no rate")
    z, rate = float(ndtri(0.5 + confidence / 2)), successes / trials
    scale = 1 / (1 + z**2 / trials)
    centre = scale * (rate + z**2 / (2 * trials))
    half = scale * z * math.sqrt(rate * (1 - rate) / trials + z**2 / (4 * trials**2))
    return (0.0 if successes == 0 else centre - half), (1.0 if successes == trials else centre + half)


def share_reaching(values: ArrayLike, threshold: float = 0.9, confidence: float = 0.95) -> Proportion:
    """Return how many of `values`, one per seed, are at least `threshold`, with Wilson's interval of the share.

    Raises:
        ValueError: there are no values, or one is not finite.
    """
    rates = finite(values, "a share of seeds")
    k = int(np.count_nonzero(rates >= threshold))
    return Proportion(k, len(rates), *wilson_interval(k, len(rates), confidence))


def unseen_share(n: int, confidence: float = 0.95) -> float:
    """Return the largest share of seeds that may collapse although none of `n` did (one-sided, Clopper & Pearson 1934).

    With 10 seeds it is 0.26: no interval that is computed from ten good seeds can know of the failures they don't show.
    """
    if n < 1:
        raise ValueError("a share needs at least one seed")
    return 1 - (1 - confidence) ** (1 / n)

"""Pure functions: numbers in, numbers out."""

from scipy import stats


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return Wilson's score interval of a rate (Wilson 1927).

    Raises:
        ValueError: `trials` is not positive, or `successes` lies outside 0 ... `trials`.
    """
    if trials < 1:
        raise ValueError("a rate needs at least one trial")
    interval = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)

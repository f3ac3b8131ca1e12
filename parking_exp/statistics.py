"""Pure functions: numbers in, numbers out."""

import math

from scipy.special import ndtri  # scipy.stats takes half a second to import, and every run needs this


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

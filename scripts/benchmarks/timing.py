"""Time two sides alternately, so that drifts of the machine affect both, and summarise the ratios."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

Side = Callable[[], float]
"""A function that does some work and returns its number of units (steps, updates)."""


def rates(side: Side) -> float:
    """Return the units per second of one call."""
    start = time.perf_counter()
    units = side()
    return units / (time.perf_counter() - start)


def interleave(ours: Side, peer: Side, rounds: int) -> dict[str, Any]:
    """Return median, lowest and highest ratio of the rates, ours / peer's, and the medians of both rates.

    Both sides are called once before, as a warm-up.
    """
    ours(), peer()
    pairs = [(rates(ours), rates(peer)) for _ in range(rounds)]
    entry = spread([our_rate / peer_rate for our_rate, peer_rate in pairs], "ratio")
    our_rates, peer_rates = zip(*pairs, strict=True)
    medians = {"ours_per_s": statistics.median(our_rates), "peer_per_s": statistics.median(peer_rates)}
    return entry | {name: rounded(value) for name, value in medians.items()}


def spread(values: Sequence[float], name: str) -> dict[str, Any]:
    """Return the median (as `name`), lowest and highest of some values, and their number (as `rounds`)."""
    return {
        name: rounded(statistics.median(values)),
        "lowest": rounded(min(values)),
        "highest": rounded(max(values)),
        "rounds": len(values),
    }


def rounded(value: float) -> float:
    """Return a value rounded to four significant digits."""
    return float(f"{value:.4g}")

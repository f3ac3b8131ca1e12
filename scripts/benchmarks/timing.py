"""Time two sides alternately, so that the machine's drifts affect both; summarise the ratios."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

Side = Callable[[], float]
"""A function that does some work and returns its number of units (steps, updates)."""


def rate(side: Side) -> float:
    """Return the units per second of one call."""
    start = time.perf_counter()
    units = side()
    return units / (time.perf_counter() - start)


def seconds(task: Callable[[], object]) -> float:
    """Return the wall time of one call."""
    start = time.perf_counter()
    task()
    return time.perf_counter() - start


def interleave(ours: Side, peer: Side, rounds: int) -> dict[str, Any]:
    """Return median, lowest and highest ratio of rates, ours / peer's, after warming up both."""
    ours(), peer()
    pairs = [(rate(ours), rate(peer)) for _ in range(rounds)]
    medians = [rounded(statistics.median(rates)) for rates in zip(*pairs, strict=True)]
    return spread([our_rate / peer_rate for our_rate, peer_rate in pairs]) | {
        "ours_per_s": medians[0],
        "peer_per_s": medians[1],
    }


def spread(values: Sequence[float]) -> dict[str, Any]:
    """Return the median, lowest and highest of some values, and their number."""
    entry = {"value": statistics.median(values), "lowest": min(values), "highest": max(values)}
    return {name: rounded(value) for name, value in entry.items()} | {"rounds": len(values)}


def rounded(value: float) -> float:
    """Return a value rounded to four significant digits."""
    return float(f"{value:.4g}")

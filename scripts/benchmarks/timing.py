"""Time two sides in turn, so that a machine whose speed drifts slows both, and summarise the ratios."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

Side = Callable[[], float]
"""Does a slice of work; returns how many units of it (steps, updates) were done."""


def rates(side: Side) -> float:
    """Return units a second of one slice."""
    start = time.perf_counter()
    units = side()
    return units / (time.perf_counter() - start)


def interleave(ours: Side, peer: Side, rounds: int) -> dict[str, Any]:
    """Return the ratio of the rates, ours / peer's: its median, lowest and highest, and both medians.

    Both sides do one slice before that is not counted.
    """
    ours(), peer()
    pairs = [(rates(ours), rates(peer)) for _ in range(rounds)]
    entry = spread([mine / theirs for mine, theirs in pairs], "ratio")
    mine, theirs = zip(*pairs, strict=True)
    return entry | {"ours_per_s": rounded(statistics.median(mine)), "peer_per_s": rounded(statistics.median(theirs))}


def spread(values: Sequence[float], name: str) -> dict[str, Any]:
    """Return median (under a name), lowest, highest and number of some values."""
    return {
        name: rounded(statistics.median(values)),
        "lowest": rounded(min(values)),
        "highest": rounded(max(values)),
        "rounds": len(values),
    }


def rounded(value: float) -> float:
    """Return a value rounded to four digits."""
    return float(f"{value:.4g}")

"""Statistics of runs: intervals, comparisons, effects, learning curves.

Functions are pure, without I/O; intervals are at 95 %.

Every training imports this package, so scipy, which takes half a second to import, is imported by
the functions that need it.
"""

from parking_exp.statistics.comparisons import (
    ENOUGH_FOR_A_TEST,
    Difference,
    compare,
)
from parking_exp.statistics.effects import MainEffect, main_effects
from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.learning_curves import (
    HOLD,
    normalised_area,
    steps_to,
)
from parking_exp.statistics.means import SeedRates, mean_interval
from parking_exp.statistics.rates import (
    finite_or_none,
    interquartile_mean,
    largest_hidden_share,
    wilson_interval,
)

__all__ = [
    "ENOUGH_FOR_A_TEST",
    "HOLD",
    "Difference",
    "Interval",
    "MainEffect",
    "SeedRates",
    "compare",
    "finite_or_none",
    "interquartile_mean",
    "largest_hidden_share",
    "main_effects",
    "mean_interval",
    "normalised_area",
    "steps_to",
    "wilson_interval",
]

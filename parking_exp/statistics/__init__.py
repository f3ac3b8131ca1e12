"""Statistics of runs: intervals, comparisons, effects, survival. Pure functions without I/O; all intervals are at 95 %.

Every training imports this package, so scipy.stats, which takes half a second to import, is imported by the functions
that need it.
"""

from parking_exp.statistics.comparisons import holm, probability_of_improvement, welch
from parking_exp.statistics.effects import MainEffect, main_effects
from parking_exp.statistics.intervals import Interval, coverage_note, mean_band, mean_interval, student_interval
from parking_exp.statistics.rates import Proportion, finite_or_none, share_reaching, unseen_share, wilson_interval
from parking_exp.statistics.survival import (
    SurvivalCurve,
    kaplan_meier,
    log_rank,
    normalised_area,
    restricted_mean,
    steps_to,
)

__all__ = [
    "Interval",
    "MainEffect",
    "Proportion",
    "SurvivalCurve",
    "coverage_note",
    "finite_or_none",
    "holm",
    "kaplan_meier",
    "log_rank",
    "main_effects",
    "mean_band",
    "mean_interval",
    "normalised_area",
    "probability_of_improvement",
    "restricted_mean",
    "share_reaching",
    "steps_to",
    "student_interval",
    "unseen_share",
    "welch",
    "wilson_interval",
]

"""Statistics of runs: intervals, comparisons, effects, survival. Pure functions without I/O.

Every training imports this package, and scipy.stats takes half a second to import: functions that need it import it
when they are called. Wilson's interval, which a training needs, is computed here; a test compares it with scipy's.
"""

from parking_exp.statistics.comparisons import Difference, holm, probability_of_improvement, welch
from parking_exp.statistics.coverage import coverage_note
from parking_exp.statistics.curves import normalised_area
from parking_exp.statistics.effects import (
    InteractionCell,
    InteractionTable,
    Level,
    MainEffect,
    contrast,
    interaction,
    main_effects,
)
from parking_exp.statistics.hyperparameters import FEWEST_ROWS, ParameterImportance, importance
from parking_exp.statistics.intervals import Interval, mean_band, mean_interval
from parking_exp.statistics.rates import Proportion, share_reaching, unseen_share, wilson_interval
from parking_exp.statistics.survival import (
    SurvivalCurve,
    kaplan_meier,
    log_rank,
    restricted_mean,
    steps_to,
)

__all__ = [
    "FEWEST_ROWS",
    "Difference",
    "InteractionCell",
    "InteractionTable",
    "Interval",
    "Level",
    "MainEffect",
    "ParameterImportance",
    "Proportion",
    "SurvivalCurve",
    "contrast",
    "coverage_note",
    "holm",
    "importance",
    "interaction",
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
    "unseen_share",
    "welch",
    "wilson_interval",
]

"""Pure functions: numbers in, numbers out. Only `log_rank` imports scipy.stats, and only when called."""

from parking_exp.statistics.curves import normalised_area
from parking_exp.statistics.effects import (
    Interaction,
    InteractionCell,
    LevelMean,
    MainEffects,
    contrast,
    interaction,
    main_effects,
)
from parking_exp.statistics.hyperparameters import FEWEST_ROWS, Importance, importance
from parking_exp.statistics.intervals import Estimate, mean_band, mean_interval
from parking_exp.statistics.notes import coverage_note
from parking_exp.statistics.pairs import Difference, Improvement, holm, probability_of_improvement, welch
from parking_exp.statistics.rates import Share, share_reaching, unseen_share, wilson_interval
from parking_exp.statistics.survival import (
    RestrictedMean,
    Survival,
    kaplan_meier,
    log_rank,
    restricted_mean,
    steps_to,
)

__all__ = [
    "FEWEST_ROWS",
    "Difference",
    "Estimate",
    "Importance",
    "Improvement",
    "Interaction",
    "InteractionCell",
    "LevelMean",
    "MainEffects",
    "RestrictedMean",
    "Share",
    "Survival",
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

"""Comparisons of cells: pairs, and main effects of crossed factors."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import pandas as pd

from parking_exp import statistics
from parking_exp.config.cell_labels import Factor
from parking_exp.reports.report_data import Cell, Pair, Verdict
from parking_exp.statistics import (
    Interval,
    MainEffect,
    finite_or_none,
    holm,
    log_rank,
    probability_of_improvement,
    welch,
)

ALL_PAIRS_UP_TO = 12  # cells: 66 pairs
SIGNIFICANT = 0.05
MAX_LEVELS = 12  # of a factor; more are values drawn from a range
COVERED = 0.5  # share of the combinations that makes a design crossed


class Family(NamedTuple):
    """Pairs that were compared, the sentence that declares them, and the cell that is part of all of them, if any."""

    pairs: list[Pair]
    sentence: str
    reference: str | None


def compare_pairs(cells: Sequence[Cell], baseline: str | None) -> Family:
    """Return the pairs of the declared family.

    These are all others against the baseline, given by its id; without one all pairs or, where cells are many, all
    against the one with the highest mean. The verdict of fewer than two finished seeds is unknown.
    """
    rated = [cell for cell in cells if cell.success.value is not None]
    reference = next((cell for cell in rated if cell.id == baseline), None)
    if reference is None and len(rated) > ALL_PAIRS_UP_TO:
        reference = max(rated, key=lambda cell: cell.success.value or 0.0)
    if reference is None:
        couples = list(combinations(rated, 2))
        family = "two cells" if len(couples) == 1 else f"all {len(couples)} pairs of {len(rated)} cells"
    else:
        couples = [(cell, reference) for cell in rated if cell is not reference]
        name = "the baseline" if reference.id == baseline else "the one with the highest mean"
        family = f"{len(couples)} cell{'s' if len(couples) > 1 else ''} against {name}"
    if not couples:
        return Family([], "", None)
    sentence = (
        f"Compared were {family}, by Welch's test on the final success of seeds; p is Holm's over this family, "
        "intervals are for each difference by itself."
    )
    if reference is not None and reference.id != baseline:
        sentence += (
            " The reference was chosen by its result, so that the others' distance from it is too large on average; "
            "name a baseline beforehand to avoid that."
        )
    pairs = [_compare(a, b) for a, b in couples]
    p_holm, log_rank_p_holm = (
        list(map(finite_or_none, holm(p))) for p in ([pair.p for pair in pairs], [pair.log_rank_p for pair in pairs])
    )
    corrected = [
        replace(pair, p_holm=p, log_rank_p_holm=times_p, verdict=_judge(pair.difference, p))
        for pair, p, times_p in zip(pairs, p_holm, log_rank_p_holm, strict=True)
    ]
    return Family(corrected, sentence, reference.id if reference else None)


def _compare(a: Cell, b: Cell) -> Pair:
    rates_a, rates_b = ([seed.success for seed in cell.seeds if seed.success is not None] for cell in (a, b))
    test = welch(rates_a, rates_b)
    times_a, times_b = (
        [(seed.steps_to_90, seed.reached_90) for seed in cell.seeds if seed.steps_to_90 is not None] for cell in (a, b)
    )
    both_timed = times_a and times_b
    log_rank_p = log_rank([*zip(*times_a, strict=True)], [*zip(*times_b, strict=True)]) if both_timed else None
    return Pair(
        a=a.id,
        b=b.id,
        difference=test.clipped(-1, 1),
        p=test.p,
        p_holm=None,
        improvement=probability_of_improvement(rates_a, rates_b),
        log_rank_p=log_rank_p,
        log_rank_p_holm=None,
        verdict="unknown",
    )


def _judge(difference: Interval, p: float | None) -> Verdict:
    if p is None or difference.value is None:
        return "unknown"
    if p >= SIGNIFICANT:
        return "same"
    return "a" if difference.value > 0 else "b"


def main_effects(cells: Sequence[Cell], factors: Sequence[Factor]) -> list[MainEffect]:
    """Return the mean of each level of each factor; none unless factors are crossed, or one number has three levels.

    A control without one of the keys, such as replay, which has no `n_sampled_goal`, is left out.
    """
    full = [cell for cell in cells if None not in cell.settings.values()]
    levels = {factor.key: {cell.settings[factor.key] for cell in full} for factor in factors}
    crossed = {key: values for key, values in levels.items() if len(values) > 1}
    sizes = [len(values) for values in crossed.values()]
    is_series = len(factors) == 1 and factors[0].numeric and len(factors[0].levels) > 2
    if len(crossed) < 2 and not is_series:
        return []
    if max(sizes) > MAX_LEVELS or len(full) < COVERED * math.prod(sizes):
        return []
    rows = [
        {**cell.settings, "success": seed.success} for cell in full for seed in cell.seeds if seed.success is not None
    ]
    return statistics.main_effects(pd.DataFrame(rows), list(crossed), "success") if rows else []

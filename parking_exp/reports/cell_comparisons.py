"""Comparisons of cells: pairs, and main effects of crossed factors."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

from parking_exp import statistics
from parking_exp.config.cell_labels import Factor
from parking_exp.errors import plural
from parking_exp.reports.report_data import Cell, Pair, Verdict
from parking_exp.statistics import (
    Difference,
    Interval,
    MainEffect,
    SeedRates,
    compare,
    finite_or_none,
    holm,
    log_rank,
    probability_of_improvement,
    rank_test,
)

ALL_PAIRS_UP_TO = 12  # cells: 66 pairs
SIGNIFICANT = 0.05
MAX_LEVELS = 12  # of a factor; more are values drawn from a range
COVERED = 0.75  # share of the combinations that makes a design crossed


class Contrasts(NamedTuple):
    """Pairs of cells that were chosen before their results were seen."""

    pairs: Sequence[tuple[str, str]]  # ids of cells
    source: str  # ends a sentence that begins with their number


class Family(NamedTuple):
    """Pairs that were compared, the sentence that declares them, and the cell that is part of all
    of them, if any.
    """

    pairs: list[Pair]
    sentence: str
    reference: str | None
    declared: bool = False  # whether the pairs are contrasts


def compare_pairs(cells: Sequence[Cell], baseline: str | None, contrasts: Contrasts) -> Family:
    """Return the comparisons of a report, of cells given by their ids.

    These are all cells against the baseline, else the contrasts, else all pairs or, where cells are
    many, all against the one with the highest mean. The verdict of fewer than two finished seeds is
    unknown.
    """
    rated = [cell for cell in cells if cell.success.value is not None]
    reference = next((cell for cell in rated if cell.id == baseline), None)
    by_id = {cell.id: cell for cell in rated}
    declared = (
        [(by_id[a], by_id[b]) for a, b in contrasts.pairs if {a, b} <= by_id.keys()]
        if reference is None
        else []
    )
    if reference is None and not declared and len(rated) > ALL_PAIRS_UP_TO:
        reference = max(rated, key=lambda cell: cell.success.value or 0.0)
    if declared:
        couples, family = declared, f"{plural(len(declared), 'pair')} {contrasts.source}"
    elif reference is None:
        couples = list(combinations(rated, 2))
        family = (
            "two cells" if len(couples) == 1 else f"all {len(couples)} pairs of {len(rated)} cells"
        )
    else:
        couples = [(cell, reference) for cell in rated if cell is not reference]
        name = "the baseline" if reference.id == baseline else "the one with the highest mean"
        family = f"{len(couples)} cell{'s' if len(couples) > 1 else ''} against {name}"
    if not couples:
        return Family([], "", None)
    sentence = (
        f"Comparisons of the final success of seeds: {family}. p has Bonferroni's correction for "
        "this family, and "
        "intervals are simultaneous: 0 lies outside exactly where p is below 0.05."
    )
    if reference is not None and reference.id != baseline:
        sentence += (
            " The reference was chosen by its result, so that the others' distance from it is too "
            "large on average; "
            "name a baseline beforehand to avoid that."
        )
    differences = compare([([seed_rates(a)], [seed_rates(b)]) for a, b in couples], SIGNIFICANT)
    pairs = [
        _compare(a, b, difference) for (a, b), difference in zip(couples, differences, strict=True)
    ]
    corrected = [
        replace(
            pair, rank_p_holm=finite_or_none(rank_p), log_rank_p_holm=finite_or_none(log_rank_p)
        )
        for pair, rank_p, log_rank_p in zip(
            pairs,
            holm([pair.rank_p for pair in pairs]),
            holm([pair.log_rank_p for pair in pairs]),
            strict=True,
        )
    ]
    return Family(corrected, sentence, reference.id if reference else None, bool(declared))


def seed_rates(cell: Cell) -> SeedRates:
    """Return the final success of a cell's seeds, and the fewest episodes of one."""
    seeds = [seed for seed in cell.seeds if seed.success is not None]
    episodes = [seed.n_episodes for seed in seeds if seed.n_episodes]
    return SeedRates(
        [seed.success or 0.0 for seed in seeds],
        min(episodes) if len(episodes) == len(seeds) else None,
    )


def _compare(a: Cell, b: Cell, difference: Difference) -> Pair:
    times_a, times_b = (
        [(seed.steps_to_90, seed.reached_90) for seed in cell.seeds if seed.steps_to_90 is not None]
        for cell in (a, b)
    )
    both_timed = times_a and times_b
    log_rank_p = (
        log_rank([*zip(*times_a, strict=True)], [*zip(*times_b, strict=True)])
        if both_timed
        else None
    )
    rates_a, rates_b = seed_rates(a).rates, seed_rates(b).rates
    return Pair(
        a=a.id,
        b=b.id,
        difference=difference,
        p=difference.p,
        p_corrected=difference.p_corrected,
        rank_p=rank_test(rates_a, rates_b),
        rank_p_holm=None,
        improvement=probability_of_improvement(rates_a, rates_b),
        log_rank_p=log_rank_p,
        log_rank_p_holm=None,
        verdict=_judge(difference, difference.p_corrected),
    )


def _judge(difference: Interval, p: float | None) -> Verdict:
    if p is None or difference.value is None:
        return "unknown"
    if p >= SIGNIFICANT:
        return "same"
    return "a" if difference.value > 0 else "b"


def main_effects(cells: Sequence[Cell], factors: Sequence[Factor]) -> list[MainEffect]:
    """Return the mean of each level of each factor; none unless factors are crossed, or one number
    has three levels.

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
    rated = [cell for cell in full if cell.success.value is not None]
    rates = [([cell.settings[key] for key in crossed], seed_rates(cell)) for cell in rated]
    return statistics.main_effects(list(crossed), rates) if rates else []

"""Pairwise comparisons of cells, corrected for how many there are."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from parking_exp.reports.report_data import Cell, Interval, Pair, Verdict, finite
from parking_exp.statistics import coverage_note, holm, log_rank, probability_of_improvement, welch

ALL_PAIRS_UP_TO = 12  # cells: 66 pairs
SIGNIFICANT = 0.05


class Family(NamedTuple):
    """Pairs that were compared, the sentence that declares them, and the cell that is part of all of them, if any."""

    pairs: list[Pair]
    sentence: str
    reference: str | None


def compare_pairs(cells: Sequence[Cell], baseline: str | None) -> Family:
    """Return the pairs of the declared family.

    Without a baseline these are all pairs or, where cells are many, all against the one with the highest mean.

    Args:
        cells: those with fewer than two finished seeds can't be tested, and their verdict is unknown.
        baseline: id of the cell that all others are compared with.
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
    pairs = [_pair(a, b) for a, b in couples]
    p_holm = holm([np.nan if pair.p is None else pair.p for pair in pairs])
    log_rank_holm = holm([np.nan if pair.log_rank_p is None else pair.log_rank_p for pair in pairs])
    corrected = [
        replace(pair, p_holm=finite(p), log_rank_p_holm=finite(times_p), verdict=_verdict(pair.difference, p))
        for pair, p, times_p in zip(pairs, p_holm, log_rank_holm, strict=True)
    ]
    return Family(corrected, sentence, reference.id if reference else None)


def _pair(a: Cell, b: Cell) -> Pair:
    rates_a, rates_b = ([seed.success for seed in cell.seeds if seed.success is not None] for cell in (a, b))
    test, better = welch(rates_a, rates_b), probability_of_improvement(rates_a, rates_b)
    n = min(len(rates_a), len(rates_b))
    times_a, times_b = (
        [(seed.steps_to_90, seed.reached_90) for seed in cell.seeds if seed.steps_to_90 is not None] for cell in (a, b)
    )
    log_rank_p = (
        finite(log_rank([*zip(*times_a, strict=True)], [*zip(*times_b, strict=True)])) if times_a and times_b else None
    )
    return Pair(
        a=a.id,
        b=b.id,
        difference=Interval.of(test.difference, test.low, test.high, n, test.method, bounds=(-1, 1)),
        p=finite(test.p),
        p_holm=None,
        improvement=Interval.of(better.probability, better.low, better.high, n, better.method),
        log_rank_p=log_rank_p,
        log_rank_p_holm=None,
        verdict="unknown",
        note=coverage_note(rates_a, rates_b),
    )


def _verdict(difference: Interval, p: float) -> Verdict:
    if np.isnan(p) or difference.value is None:
        return "unknown"
    if p >= SIGNIFICANT:
        return "same"
    return "a" if difference.value > 0 else "b"

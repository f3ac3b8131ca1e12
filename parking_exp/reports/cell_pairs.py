"""Pairwise comparisons of cells, corrected for how many there are."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

from parking_exp.reports.report_data import Cell, Pair, Verdict
from parking_exp.statistics import Interval, coverage_note, holm, log_rank, probability_of_improvement, welch
from parking_exp.statistics.checks import finite_or_none

ALL_PAIRS_UP_TO = 12  # cells: 66 pairs
SIGNIFICANT = 0.05


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
    pairs = [_pair(a, b) for a, b in couples]
    p_holm, log_rank_p_holm = (
        list(map(finite_or_none, holm(p))) for p in ([pair.p for pair in pairs], [pair.log_rank_p for pair in pairs])
    )
    corrected = [
        replace(pair, p_holm=p, log_rank_p_holm=times_p, verdict=_verdict(pair.difference, p))
        for pair, p, times_p in zip(pairs, p_holm, log_rank_p_holm, strict=True)
    ]
    return Family(corrected, sentence, reference.id if reference else None)


def _pair(a: Cell, b: Cell) -> Pair:
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
        note=coverage_note(rates_a, rates_b),
    )


def _verdict(difference: Interval, p: float | None) -> Verdict:
    if p is None or difference.value is None:
        return "unknown"
    if p >= SIGNIFICANT:
        return "same"
    return "a" if difference.value > 0 else "b"

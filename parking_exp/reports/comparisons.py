"""Pairwise comparisons of cells, corrected for how many there are."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np

from parking_exp.reports.formats import finite, within
from parking_exp.reports.report_data import Cell, Interval, Pair, Survival
from parking_exp.statistics import coverage_note, holm, log_rank, probability_of_improvement, welch

ALL_PAIRS_UP_TO = 12  # cells: 66 pairs
SIGNIFICANT = 0.05


class Family(NamedTuple):
    """Pairs that were compared, the sentence that declares them, and the cell that is part of all of them, if any."""

    pairs: list[Pair]
    words: str
    reference: str | None


def compare_pairs(cells: Sequence[Cell], baseline: str | None) -> Family:
    """Return the pairs of the declared family.

    Without a baseline these are all pairs or, where cells are many, all against the one with the highest mean.

    Args:
        cells: those with fewer than two finished seeds can't be tested, and their verdict is unknown.
        baseline: id of the cell that all others are compared with.
    """
    having = [cell for cell in cells if cell.success.value is not None]
    reference = next((cell for cell in having if cell.id == baseline), None)
    if reference is None and len(having) > ALL_PAIRS_UP_TO:
        reference = max(having, key=lambda cell: cell.success.value or 0.0)
    if reference is None:
        couples = list(combinations(having, 2))
        family = "two cells" if len(couples) == 1 else f"all {len(couples)} pairs of {len(having)} cells"
    else:
        couples = [(cell, reference) for cell in having if cell.id != reference.id]
        name = "the baseline" if reference.id == baseline else "the one with the highest mean"
        family = f"{len(couples)} cell{'s' if len(couples) > 1 else ''} against {name}"
    if not couples:
        return Family([], "", None)
    words = (
        f"Compared were {family}, by Welch's test on the final success of seeds; p is Holm's over this family, "
        "intervals are for each difference by itself."
    )
    if reference is not None and reference.id != baseline:
        words += (
            " The reference was chosen by its result, so that the others' distance from it is too large on average; "
            "name a baseline beforehand to avoid that."
        )
    pairs = _corrected([_pair(a, b) for a, b in couples])
    return Family(pairs, words, reference.id if reference else None)


def _pair(a: Cell, b: Cell) -> Pair:
    ours, theirs = _rates(a), _rates(b)
    test, better = welch(ours, theirs), probability_of_improvement(ours, theirs)
    n = min(len(ours), len(theirs))
    return Pair(
        a=a.id,
        b=b.id,
        difference=Interval(test.difference, within(test.low, -1, 1), within(test.high, -1, 1), n, test.method),
        p=finite(test.p),
        p_holm=None,
        improvement=Interval(better.probability, finite(better.low), finite(better.high), n, better.method),
        log_rank_p=_times(a.survival, a, b),
        log_rank_p_holm=None,
        verdict="unknown",
        note=coverage_note(ours, theirs),
    )


def _corrected(pairs: Sequence[Pair]) -> list[Pair]:
    corrected = holm([np.nan if pair.p is None else pair.p for pair in pairs])
    times = holm([np.nan if pair.log_rank_p is None else pair.log_rank_p for pair in pairs])
    return [
        replace(pair, p_holm=finite(p), log_rank_p_holm=finite(time), verdict=_verdict(pair, finite(p)))
        for pair, p, time in zip(pairs, corrected, times, strict=True)
    ]


def _verdict(pair: Pair, p: float | None) -> Literal["a", "b", "same", "unknown"]:
    if p is None or pair.difference.value is None:
        return "unknown"
    if p >= SIGNIFICANT:
        return "same"
    return "a" if pair.difference.value > 0 else "b"


def _times(survival: Survival | None, a: Cell, b: Cell) -> float | None:
    if survival is None or b.survival is None:
        return None
    ours, theirs = (
        (
            np.array([seed.steps_to_90 for seed in cell.seeds if seed.steps_to_90 is not None]),
            np.array([seed.reached_90 for seed in cell.seeds if seed.steps_to_90 is not None]),
        )
        for cell in (a, b)
    )
    return finite(log_rank(ours, theirs))


def _rates(cell: Cell) -> list[float]:
    return [seed.success for seed in cell.seeds if seed.success is not None]

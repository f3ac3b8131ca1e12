"""Comparisons of cells: pairs, the kind of design, main effects and interactions of factors."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from parking_exp import statistics
from parking_exp.config.cell_labels import FEW_CELLS, Factor, Setting, hashable, setting
from parking_exp.reports.report_data import Cell, Design, Interaction, Pair, Verdict
from parking_exp.statistics import (
    Interval,
    MainEffect,
    coverage_note,
    finite_or_none,
    holm,
    log_rank,
    probability_of_improvement,
    welch,
)

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


RESPONSE = "success"
SEARCH_CELLS = 8
MOST_LEVELS = 12
COVERED = 0.5  # share of the combinations that makes a design factorial
MOST_TABLES = 6
MOST_GIVEN = 4
N_SAMPLED_GOAL = "buffer.n_sampled_goal"
NO_RUNS = (None, None, None, 0, None)


def design(factors: Sequence[Factor], settings: Sequence[Mapping[str, Setting]]) -> Design:
    """Return the kind of design, judged by how many of the possible combinations there are."""
    if len(settings) < 2:
        return "single"
    drawn = max(FEW_CELLS + 1, len(settings) / 2)
    if len(settings) >= SEARCH_CELLS and any(factor.numeric and len(factor.levels) >= drawn for factor in factors):
        return "search"
    if len(factors) == 1:
        return "factorial" if factors[0].numeric and len(factors[0].levels) > 2 else "list"
    # A control without hindsight has no `n_sampled_goal`, and is no part of the crossing.
    complete = [cell for cell in settings if all(cell[factor.key] is not None for factor in factors)]
    levels = [len({hashable(cell[factor.key]) for cell in complete}) for factor in factors]
    if sum(count > 1 for count in levels) < 2 or max(levels) > MOST_LEVELS:
        return "list"
    return "factorial" if len(complete) >= COVERED * math.prod(levels) else "list"


def main_effects(cells: Sequence[Cell], factors: Sequence[Factor]) -> list[MainEffect]:
    """Return the mean of each level of each factor, over the cells that have a value of all of them."""
    crossed = _crossed(factors, cells)
    frame = _frame(cells, crossed)
    if not len(frame):
        return []
    return statistics.main_effects(frame, [factor.key for factor in crossed], RESPONSE)


def interactions(
    cells: Sequence[Cell], factors: Sequence[Factor], real_shares: Mapping[str, float | None]
) -> list[Interaction]:
    """Return tables of two factors each, one for each setting of the others where these are few.

    A control that has no value of the column's factor is a row with one column of its own, `null`. `real_shares` are
    measured shares of real transitions, by id of the cell.
    """
    crossed = _crossed(factors, cells)
    if len(crossed) > 2:  # an env is what a table is for
        crossed = [factor for factor in crossed if factor.key != "env"]
    tables: list[Interaction] = []
    for row, column in combinations(crossed, 2):
        for given, some in _given(cells, [factor for factor in factors if factor not in (row, column)]):
            if len(tables) < MOST_TABLES and (table := _interaction(some, row, column, given, real_shares)):
                tables.append(table)
    corrected = statistics.holm([table.p for table in tables])
    return [replace(table, p=finite_or_none(p)) for table, p in zip(tables, corrected, strict=True)]


def _interaction(
    cells: Sequence[Cell], row: Factor, column: Factor, given: str | None, real_shares: Mapping[str, float | None]
) -> Interaction | None:
    frame = _frame(cells, [row, column])
    if not len(frame) or frame[row.key].nunique() < 2 or frame[column.key].nunique() < 2:
        return None
    table = statistics.interaction(frame, row.key, column.key, RESPONSE)
    entries: dict[tuple[Setting, Setting], Sequence[float | int | None]] = {
        place: (mean.value, mean.low, mean.high, mean.n, residual) for place, (mean, residual) in table.cells.items()
    }
    rows, columns = list(table.rows), list(table.columns)
    for control in cells:
        level, mean = control.settings[row.key], control.success
        if control.settings[column.key] is None and level is not None:
            entries[level, None] = (mean.value, mean.low, mean.high, mean.n, None)
            rows += [] if level in rows else [level]
            columns += [] if None in columns else [None]
    grids: list[Any] = [[[entries.get((r, c), NO_RUNS)[part] for c in columns] for r in rows] for part in range(5)]
    shares = None
    if column.key == N_SAMPLED_GOAL:
        measured = _shares(cells, row, column, real_shares)
        measured |= {place: 1.0 for place in entries if place[1] is None}
        shares = [[measured.get((r, c)) for c in columns] for r in rows]
    mean, low, high, n, residual = grids
    return Interaction(row.key, column.key, given, rows, columns, mean, low, high, n, residual, shares, table.p)


def _shares(
    cells: Sequence[Cell], row: Factor, column: Factor, real_shares: Mapping[str, float | None]
) -> dict[tuple[Setting, Setting], float]:
    """Return the mean share of real transitions of the cells of each combination, where it is known."""
    known: dict[tuple[Setting, Setting], list[float]] = {}
    for cell in cells:
        if (share := real_shares.get(cell.id)) is not None:
            known.setdefault((cell.settings[row.key], cell.settings[column.key]), []).append(share)
    return {place: float(np.mean(shares)) for place, shares in known.items()}


def _given(cells: Sequence[Cell], others: Sequence[Factor]) -> Iterator[tuple[str | None, list[Cell]]]:
    """Yield the cells for each setting of the other factors; all at once where there are many settings."""
    settings = list(product(*(factor.levels for factor in others)))
    if not others or len(settings) > MOST_GIVEN:
        yield None, list(cells)
        return
    for values in settings:
        given = list(zip(others, values, strict=True))
        text = ", ".join(f"{factor.name}={setting(value)}" for factor, value in given)
        yield text, [cell for cell in cells if all(cell.settings[factor.key] == value for factor, value in given)]


def _crossed(factors: Sequence[Factor], cells: Sequence[Cell]) -> list[Factor]:
    """Return the factors that have two levels or more among the cells with a value of all of them."""
    full = [cell for cell in cells if all(cell.settings[factor.key] is not None for factor in factors)]
    return [factor for factor in factors if len({setting(cell.settings[factor.key]) for cell in full}) > 1]


def _frame(cells: Sequence[Cell], factors: Sequence[Factor]) -> pd.DataFrame:
    """Return one row a finished seed of the cells that have a value of all factors."""
    keys = [factor.key for factor in factors]
    rows = [
        {**{key: cell.settings[key] for key in keys}, RESPONSE: seed.success}
        for cell in cells
        if all(cell.settings[key] is not None for key in keys)
        for seed in cell.seeds
        if seed.success is not None
    ]
    return pd.DataFrame(rows, columns=[*keys, RESPONSE])

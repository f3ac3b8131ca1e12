"""The kind of design that cells make, main effects and interactions of crossed factors, importance in a search."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd

from parking_exp import statistics
from parking_exp.config.cell_labels import FEW_CELLS, Factor, Setting, hashable, setting
from parking_exp.reports.report_data import Cell, Design, Interaction
from parking_exp.statistics import MainEffect
from parking_exp.statistics.checks import finite_or_none
from parking_exp.statistics.effects import FEWEST_ROWS

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


def importance(cells: Sequence[Cell], factors: Sequence[Factor]) -> list[statistics.ParameterImportance]:
    """Return the share of the variance between cells that each factor explains alone, the largest first."""
    rows = [{**cell.settings, RESPONSE: cell.success.value} for cell in cells if cell.success.value is not None]
    if len(rows) < FEWEST_ROWS:
        return []
    frame = pd.DataFrame(rows)
    usable = [factor.key for factor in factors if not (factor.numeric and frame[factor.key].isna().any())]
    return sorted(statistics.importance(frame, usable, RESPONSE), key=lambda importance: -importance.share)


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

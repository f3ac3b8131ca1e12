"""Main effects and interactions of crossed factors, importance of hyperparameters in a search."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd

from parking_exp import statistics
from parking_exp.reports.formats import finite, setting, within
from parking_exp.reports.report_data import (
    Cell,
    Factor,
    Importance,
    Interaction,
    Interval,
    Level,
    MainEffect,
    Setting,
)

RESPONSE = "success"
MOST_TABLES = 6
MOST_GIVEN = 4
REAL = "buffer.n_sampled_goal"


def main_effects(cells: Sequence[Cell], factors: Sequence[Factor]) -> list[MainEffect]:
    """Return the mean of each level of each factor, over the cells that have a value of all of them."""
    crossing = _crossed(factors, cells)
    frame = _frame(cells, crossing)
    if not len(frame):
        return []
    keys = [factor.key for factor in crossing]
    found = statistics.main_effects(frame, keys, RESPONSE)
    return [_main_effect(factor, frame, keys, found) for factor in crossing]


def _main_effect(factor: Factor, frame: pd.DataFrame, keys: Sequence[str], found: statistics.MainEffects) -> MainEffect:
    means = [level for level in found.levels if level.factor == factor.key]
    levels = []
    for one in means:
        mean = Interval(one.mean, within(one.low, 0, 1), within(one.high, 0, 1), one.seeds, one.method)
        levels.append(Level(one.level, mean, one.cells))
    if len(means) < 2:  # of the others, no run is done yet
        return MainEffect(factor.key, levels, found.complete)
    highest, lowest = max(means, key=lambda one: one.mean), min(means, key=lambda one: one.mean)
    gap = statistics.contrast(frame, keys, RESPONSE, (factor.key, highest.level, lowest.level))
    low, high = (within(bound, -1, 1) for bound in (gap.low, gap.high))
    largest = Interval(gap.difference, low, high, min(gap.n_a, gap.n_b), gap.method)
    pairs = len(means) * (len(means) - 1) // 2
    p = None if np.isnan(gap.p) else min(1.0, gap.p * pairs)
    return MainEffect(factor.key, levels, found.complete, largest, p)


def interactions(
    cells: Sequence[Cell], factors: Sequence[Factor], real_shares: Mapping[str, float | None]
) -> list[Interaction]:
    """Return tables of two factors each, one for each setting of the others where these are few.

    Args:
        cells: a control that has no value of the column's factor is a row with one column of its own, `null`.
        factors: of the design.
        real_shares: measured share of real transitions, by id of the cell.
    """
    crossed = _crossed(factors, cells)
    if len(crossed) > 2:  # an env is what a table is for
        crossed = [factor for factor in crossed if factor.key != "env"]
    pairs = combinations(crossed, 2)
    found: list[Interaction] = []
    for row, column in pairs:
        for given, some in _given(cells, [one for one in factors if one not in (row, column)]):
            if len(found) < MOST_TABLES and (table := _interaction(some, row, column, given, real_shares)):
                found.append(table)
    corrected = statistics.holm([np.nan if table.p is None else table.p for table in found])
    return [replace(table, p=finite(p)) for table, p in zip(found, corrected, strict=True)]


def importance(cells: Sequence[Cell], factors: Sequence[Factor]) -> list[Importance]:
    """Return the share of the variance between cells that each factor explains alone, the largest first."""
    rows = [{**cell.settings, RESPONSE: cell.success.value} for cell in cells if cell.success.value is not None]
    frame = pd.DataFrame(rows)
    usable = [
        factor.key for factor in factors if len(frame) and not (factor.numeric and frame[factor.key].isna().any())
    ]
    if len(frame) < statistics.FEWEST_ROWS or not usable:
        return []
    found = statistics.importance(frame, usable, RESPONSE)
    ranked = [Importance(one.parameter, one.share, one.p, one.spearman) for one in found]
    return sorted(ranked, key=lambda one: -one.share)


def _interaction(
    cells: Sequence[Cell], row: Factor, column: Factor, given: str | None, real_shares: Mapping[str, float | None]
) -> Interaction | None:
    whole = _frame(cells, [row, column])
    if not len(whole) or whole[row.key].nunique() < 2 or whole[column.key].nunique() < 2:
        return None
    table = statistics.interaction(whole, row.key, column.key, RESPONSE)
    at = {(one.row, one.column): one for one in table.cells}
    rows, columns = list(table.rows), list(table.columns)
    controls = [cell for cell in cells if cell.settings[column.key] is None and cell.settings[row.key] is not None]
    columns_shown: list[Setting] = [*columns, *([None] if controls else [])]
    rows_shown: list[Setting] = [*rows, *dict.fromkeys(cell.settings[row.key] for cell in controls)]
    numbers = {(r, c): _entry(one) for (r, c), one in at.items()}
    numbers |= {
        (cell.settings[row.key], None): (cell.success.value, cell.success.low, cell.success.high, cell.success.n, None)
        for cell in controls
    }
    nothing = (None, None, None, 0, None)
    grid = [[numbers.get((r, c), nothing) for c in columns_shown] for r in rows_shown]
    mean, low, high, n, residual = ([[entry[part] for entry in line] for line in grid] for part in range(5))
    shares = None
    if column.key == REAL:
        found = _shares(cells, row, column, real_shares)
        found |= {(cell.settings[row.key], None): 1.0 for cell in controls}
        shares = [[found.get((r, c)) for c in columns_shown] for r in rows_shown]
    return Interaction(
        row.key, column.key, given, rows_shown, columns_shown, mean, low, high, n, residual, shares, finite(table.p)
    )


def _entry(one: statistics.InteractionCell) -> tuple[Any, ...]:
    return (finite(one.mean), finite(one.low), finite(one.high), one.n, finite(one.residual))


def _shares(
    cells: Sequence[Cell], row: Factor, column: Factor, real_shares: Mapping[str, float | None]
) -> dict[tuple[Setting, Setting], float]:
    """Return the mean share of real transitions of the cells of each combination, where it is known."""
    found: dict[tuple[Setting, Setting], list[float]] = {}
    for cell in cells:
        if (share := real_shares.get(cell.id)) is not None:
            found.setdefault((cell.settings[row.key], cell.settings[column.key]), []).append(share)
    return {place: float(np.mean(shares)) for place, shares in found.items()}


def _given(cells: Sequence[Cell], others: Sequence[Factor]) -> Iterator[tuple[str | None, list[Cell]]]:
    """Yield the cells for each setting of the other factors; all at once where there are many settings."""
    settings = list(product(*(factor.levels for factor in others)))
    if not others or len(settings) > MOST_GIVEN:
        yield None, list(cells)
        return
    for values in settings:
        words = ", ".join(f"{factor.name}={setting(value)}" for factor, value in zip(others, values, strict=True))
        some = [
            cell
            for cell in cells
            if all(cell.settings[factor.key] == value for factor, value in zip(others, values, strict=True))
        ]
        yield words, some


def _crossed(factors: Sequence[Factor], cells: Sequence[Cell]) -> list[Factor]:
    """Return the factors that have two levels or more among the cells with a value of all of them."""
    full = [cell for cell in cells if all(cell.settings[factor.key] is not None for factor in factors)]
    return [factor for factor in factors if len({setting(cell.settings[factor.key]) for cell in full}) > 1]


def _frame(cells: Sequence[Cell], factors: Sequence[Factor]) -> pd.DataFrame:
    """Return one row a finished seed of the cells that have a value of all factors."""
    rows = [
        {**{factor.key: cell.settings[factor.key] for factor in factors}, RESPONSE: seed.success}
        for cell in cells
        if all(cell.settings[factor.key] is not None for factor in factors)
        for seed in cell.seeds
        if seed.success is not None
    ]
    return pd.DataFrame(rows, columns=[*(factor.key for factor in factors), RESPONSE])

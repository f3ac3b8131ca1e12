"""Main effects and contrasts of crossed factors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from parking_exp.statistics.comparisons import Difference, compare, contrast
from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.means import SeedRates


@dataclass(frozen=True)
class Level:
    """A level's mean over the levels of the other factors, all cells with equal weight."""

    level: Any
    effect: Interval
    cells: int


@dataclass(frozen=True)
class MainEffect:
    """What one factor does on average over the others.

    Attributes:
        factor: its key.
        levels: the mean of each.
        highest: the level with the highest mean; of equal ones, the first.
        lowest: the level with the lowest mean; of equal ones, the last.
        largest: the highest mean minus the lowest, corrected (Bonferroni) over all pairs of levels.
    """

    factor: str
    levels: Sequence[Level]
    highest: Level
    lowest: Level
    largest: Difference


def main_effects(
    factors: Sequence[str], cells: Sequence[tuple[Sequence[Any], SeedRates]]
) -> list[MainEffect]:
    """Return the main effect of every factor with more than one level.

    A cell is (level of each factor, rates), and there is one of each combination. All cells have
    equal weights. Intervals and p come from `compare`, which permutes seeds between cells with the
    same levels of the other factors. Levels are sorted, numbers before texts.
    """
    by_factor = [_group_by_level(cells, number) for number in range(len(factors))]
    return [
        _main_effect(factor, levels)
        for factor, levels in zip(factors, by_factor, strict=True)
        if len(levels) > 1
    ]


def _group_by_level(
    cells: Sequence[tuple[Sequence[Any], SeedRates]], factor_number: int
) -> dict[Any, list[SeedRates]]:
    """Return the cells of each level of a factor, in the order of their other levels."""
    groups: dict[Any, list[SeedRates]] = {}
    for levels, rates in sorted(cells, key=lambda cell: str(cell[0])):
        groups.setdefault(levels[factor_number], []).append(rates)
    order = sorted(groups, key=lambda level: (isinstance(level, str), level))
    return {level: groups[level] for level in order}


def _main_effect(factor: str, cells: Mapping[Any, Sequence[SeedRates]]) -> MainEffect:
    levels = [Level(level, contrast(rates), len(rates)) for level, rates in cells.items()]
    ranked = sorted(levels, key=lambda level: level.effect.value or 0.0, reverse=True)
    highest = ranked[0]
    lowest = ranked[-1]
    n_pairs = math.comb(len(levels), 2)
    (largest,) = compare([(cells[highest.level], cells[lowest.level])], n_pairs=n_pairs)
    return MainEffect(factor, levels, highest, lowest, largest)

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

    @property
    def mean(self) -> float:
        """The mean; 0 without data."""
        return self.effect.value or 0.0


@dataclass(frozen=True)
class MainEffect:
    """What one factor does on average over the others.

    Attributes:
        factor: its key.
        levels: the mean of each.
        complete: whether all combinations are there; else levels are averaged over different cells.
        highest: the level with the highest mean; of equal ones, the first.
        lowest: the level with the lowest mean; of equal ones, the last.
        largest: the highest mean minus the lowest, with a corrected interval.
        p_corrected: the p value of that difference, corrected (Bonferroni) over all pairs of
            levels; None where combinations are missing.
    """

    factor: str
    levels: Sequence[Level]
    complete: bool
    highest: Level
    lowest: Level
    largest: Difference
    p_corrected: float | None


def main_effects(
    factors: Sequence[str], cells: Sequence[tuple[Sequence[Any], SeedRates]]
) -> list[MainEffect]:
    """Return the main effect of every factor with more than one level.

    A cell is (level of each factor, rates). All cells have equal weights. Intervals and p come
    from `compare`, which permutes seeds between cells with the same levels of the other factors.
    There is no p if combinations are missing. Levels are sorted, numbers before texts.
    """
    by_factor = [_group_by_level(cells, number) for number in range(len(factors))]
    n_combinations = math.prod(len(levels) for levels in by_factor)
    complete = len({tuple(levels) for levels, _ in cells}) == n_combinations
    return [
        _main_effect(factor, levels, complete)
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


def _main_effect(
    factor: str, cells: Mapping[Any, Sequence[SeedRates]], complete: bool
) -> MainEffect:
    levels = [Level(level, contrast(rates), len(rates)) for level, rates in cells.items()]
    highest = max(levels, key=lambda level: level.mean)
    lowest = min(reversed(levels), key=lambda level: level.mean)
    n_pairs = math.comb(len(levels), 2)
    (largest,) = compare([(cells[highest.level], cells[lowest.level])], n_pairs=n_pairs)
    p_corrected = largest.p_corrected if complete else None
    return MainEffect(factor, levels, complete, highest, lowest, largest, p_corrected)

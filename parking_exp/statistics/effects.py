"""Main effects and contrasts of crossed factors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from parking_exp.statistics.comparisons import compare
from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.means import SeedRates, contrast


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
        factor: its name.
        levels: the mean of each.
        complete: whether all combinations are there; else levels are averaged over different cells.
        largest: the highest mean minus the lowest, with an interval corrected as p; None with a
            single level.
        p: of that difference, corrected (Bonferroni) over all pairs of levels.
    """

    factor: str
    levels: Sequence[Level]
    complete: bool
    largest: Interval | None = None
    p: float | None = None

    @property
    def size(self) -> float:
        """The difference between its highest and its lowest mean; 0 with a single level."""
        return self.largest.value or 0.0 if self.largest else 0.0

    @property
    def extremes(self) -> tuple[Level, Level]:
        """The levels with the highest and the lowest mean, the first of equal ones."""

        def mean(level: Level) -> float:
            return level.effect.value or 0.0

        return max(self.levels, key=mean), min(self.levels, key=mean)


def main_effects(
    factors: Sequence[str], cells: Sequence[tuple[Sequence[Any], SeedRates]]
) -> list[MainEffect]:
    """Return the mean of cell means for every level of every factor; `cells` are (level of each
    factor, rates).

    Cells have equal weights. Intervals and p are those of `compare`; there are none if a cell of
    the level has a single seed. Levels are in order, numbers before texts.
    """
    by_factor = []
    for place in range(len(factors)):
        levels = sorted(
            {key[place] for key, _ in cells}, key=lambda level: (isinstance(level, str), level)
        )
        by_factor.append(
            {level: [rates for key, rates in cells if key[place] == level] for level in levels}
        )
    complete = len({tuple(key) for key, _ in cells}) == math.prod(map(len, by_factor))
    return [
        _main_effect(factor, own, complete) for factor, own in zip(factors, by_factor, strict=True)
    ]


def _main_effect(name: str, own: Mapping[Any, Sequence[SeedRates]], complete: bool) -> MainEffect:
    levels = [Level(level, contrast(cells).interval(), len(cells)) for level, cells in own.items()]
    if len(levels) < 2:
        return MainEffect(name, levels, complete)
    order = sorted(levels, key=lambda level: level.effect.value or 0.0, reverse=True)
    pairs = [(own[high.level], own[low.level]) for high, low in combinations(order, 2)]
    largest = compare(pairs)[len(levels) - 2]  # the first level minus the last
    return MainEffect(name, levels, complete, largest, largest.p_corrected)

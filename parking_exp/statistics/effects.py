"""Main effects and contrasts of crossed factors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

from parking_exp.statistics.comparisons import compare
from parking_exp.statistics.intervals import Interval
from parking_exp.statistics.means import SeedRates, contrast

if TYPE_CHECKING:  # a training imports this package, but not pandas
    from collections.abc import Mapping, Sequence

    import pandas as pd

    Cells = Mapping[tuple[Any, ...], Any]  # levels of the factors -> responses


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
        largest: the highest mean minus the lowest, with an interval corrected as p; None with a single level.
        p: of that difference, corrected (Holm) over all pairs of levels.
    """

    factor: str
    levels: Sequence[Level]
    complete: bool
    largest: Interval | None = None
    p: float | None = None


def main_effects(
    frame: pd.DataFrame, factors: Sequence[str], response: str, n_episodes: int | None = None
) -> list[MainEffect]:
    """Return the mean of cell means for every level of every factor; `frame` has a row per seed.

    Cells have equal weights. The response is a rate in 0 ... 1, each over `n_episodes` episodes. Intervals and p are
    those of `compare`; there are none if a cell of the level has a single seed.
    """
    cells = {key: SeedRates(values, n_episodes) for key, values in _cells(frame, factors, response).items()}
    levels = [_levels(cells, place) for place in range(len(factors))]
    complete = len(cells) == math.prod(map(len, levels))
    effects = []
    for place, factor in enumerate(factors):
        own = {level: [values for key, values in cells.items() if key[place] == level] for level in levels[place]}
        effects.append(_main_effect(factor, own, complete))
    return effects


def _main_effect(name: str, own: Mapping[Any, Sequence[SeedRates]], complete: bool) -> MainEffect:
    levels = [Level(level, contrast(cells).interval(), len(cells)) for level, cells in own.items()]
    if len(levels) < 2:
        return MainEffect(name, levels, complete)
    order = sorted(levels, key=lambda level: level.effect.value or 0.0, reverse=True)
    pairs = [(own[high.level], own[low.level]) for high, low in combinations(order, 2)]
    largest = compare(pairs)[len(levels) - 2]  # the first level minus the last
    return MainEffect(name, levels, complete, largest, largest.p_holm)


def _cells(frame: pd.DataFrame, factors: Sequence[str], response: str) -> Cells:
    """Return the responses of every combination of levels that is there."""
    return {key: values.to_numpy(float) for key, values in frame.groupby(list(factors), sort=False)[response]}


def _levels(cells: Cells, place: int) -> list[Any]:
    """Return the sorted levels of a factor, numbers before texts."""
    return sorted({key[place] for key in cells}, key=lambda level: (isinstance(level, str), level))

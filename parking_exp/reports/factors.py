"""The kind of design that the cells of a comparison make."""

import math
from collections.abc import Mapping, Sequence

from parking_exp.config.cell_labels import FEW_CELLS, Factor, Setting, hashable
from parking_exp.reports.report_data import Design

SEARCH_CELLS = 8
MOST_LEVELS = 12
COVERED = 0.5


def design(factors: Sequence[Factor], settings: Sequence[Mapping[str, Setting]]) -> Design:
    """Tell the kind of design from how many of the possible combinations there are."""
    if len(settings) < 2:
        return "single"
    drawn = max(FEW_CELLS + 1, len(settings) / 2)
    if len(settings) >= SEARCH_CELLS and any(factor.numeric and len(factor.levels) >= drawn for factor in factors):
        return "search"
    crossed = complete_cases(factors, settings)
    if len(factors) == 1:
        return "factorial" if factors[0].numeric and len(factors[0].levels) > 2 else "list"
    levels = [len({hashable(settings[cell][factor.key]) for cell in crossed}) for factor in factors]
    possible = math.prod(levels)
    # Of factors with one level only there is nothing to cross.
    if sum(count > 1 for count in levels) < 2 or max(levels) > MOST_LEVELS:
        return "list"
    return "factorial" if len(crossed) >= COVERED * possible else "list"


def complete_cases(factors: Sequence[Factor], settings: Sequence[Mapping[str, Setting]]) -> list[int]:
    """Return the cells that have a value of every factor: a control without hindsight has no `n_sampled_goal`."""
    return [cell for cell, one in enumerate(settings) if all(one[factor.key] is not None for factor in factors)]

"""Comparisons of cells: pairs of them, and levels of crossed factors."""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

from parking_exp.config.cell_labels import Factor
from parking_exp.phrases import plural
from parking_exp.reports.report_data import CellSummary, Pair, Verdict
from parking_exp.statistics import (
    Difference,
    MainEffect,
    SeedRates,
    compare,
    main_effects,
)

ALL_PAIRS_UP_TO = 12  # cells: 66 pairs
SIGNIFICANT = 0.05
# With more levels, values were probably drawn from a range: no main effects.
MAX_LEVELS = 12

FAMILY = (
    "Comparisons of the final success of seeds: {}. p is that of the exact permutation test, with "
    "Bonferroni's correction for this family, for which intervals are simultaneous."
)
CHOSEN_BY_RESULT = (
    " The reference was chosen by its result, so that the others' distance from it is too large on "
    "average; name a baseline beforehand to avoid that."
)


class Family(NamedTuple):
    """Pairs of cells that are compared together.

    Attributes:
        sentence: says which pairs they are and how p is corrected.
        reference: id of the cell that is part of all pairs, if any.
        declared: whether the pairs were declared as contrasts.
    """

    cell_pairs: Sequence[tuple[CellSummary, CellSummary]] = ()
    sentence: str = ""
    reference: str | None = None
    declared: bool = False


def choose_family(
    cells: Sequence[CellSummary], baseline: str | None, contrasts: Sequence[tuple[str, str]]
) -> Family:
    """Return the pairs that a report compares; baseline and contrasts are ids of cells.

    The first of these that is possible:

    - all cells against the baseline
    - the contrasts
    - all pairs of at most ALL_PAIRS_UP_TO cells
    - all cells against the cell with the highest mean
    """
    rated = {cell.id: cell for cell in cells if cell.success.value is not None}
    if baseline in rated:
        return _compare_with(rated[baseline], rated, "the baseline")

    chosen = [(rated[a], rated[b]) for a, b in contrasts if a in rated and b in rated]
    if chosen:
        words = plural(len(chosen), "declared contrast")
        return Family(chosen, FAMILY.format(words), declared=True)

    if len(rated) > ALL_PAIRS_UP_TO:
        best = max(rated.values(), key=lambda cell: cell.success.value or 0.0)
        family = _compare_with(best, rated, "the one with the highest mean")
        return family._replace(sentence=family.sentence + CHOSEN_BY_RESULT)

    cell_pairs = list(combinations(rated.values(), 2))
    if not cell_pairs:
        return Family()
    words = "two cells"
    if len(cell_pairs) > 1:
        words = f"all {len(cell_pairs)} pairs of {len(rated)} cells"
    return Family(cell_pairs, FAMILY.format(words))


def _compare_with(reference: CellSummary, rated: Mapping[str, CellSummary], name: str) -> Family:
    cell_pairs = [(cell, reference) for cell in rated.values() if cell is not reference]
    if not cell_pairs:
        return Family()
    words = f"{plural(len(cell_pairs), 'cell')} against {name}"
    return Family(cell_pairs, FAMILY.format(words), reference.id)


def compare_pairs(cell_pairs: Sequence[tuple[CellSummary, CellSummary]]) -> list[Pair]:
    """Return the comparisons of a family, each corrected for all of them."""
    from scipy.stats import mannwhitneyu

    rates = [(seed_rates(a), seed_rates(b)) for a, b in cell_pairs]
    n_pairs = len(cell_pairs)
    differences = compare([([a], [b]) for a, b in rates], SIGNIFICANT, n_pairs)

    pairs = []
    for (a, b), (a_rates, b_rates), difference in zip(cell_pairs, rates, differences, strict=True):
        rank_p = None
        if difference.p is not None:
            rank_p = min(1.0, n_pairs * mannwhitneyu(a_rates.rates, b_rates.rates).pvalue)
        pairs.append(Pair(a.id, b.id, difference, rank_p, judge(difference)))
    return pairs


def seed_rates(cell: CellSummary) -> SeedRates:
    """Return the final success of a cell's seeds, and the fewest episodes of any seed.

    At least one seed must have a rate.
    """
    rates = []
    n_episodes = []
    for seed in cell.seeds:
        if seed.success is not None:
            rates.append(seed.success)
            n_episodes.append(seed.n_episodes or 0)
    return SeedRates(rates, min(n_episodes) or None)


def judge(difference: Difference) -> Verdict:
    """Return the verdict of test and interval: `unclear` where only one of them finds a difference.

    The test has no power with few seeds; the interval is too narrow where seeds collapse.
    """
    if difference.p_corrected is None or difference.low is None or difference.high is None:
        return "unknown"
    is_significant = difference.p_corrected < SIGNIFICANT
    excludes_0 = difference.low > 0 or difference.high < 0
    if is_significant != excludes_0:
        return "unclear"
    if not is_significant:
        return "same"
    return "a" if difference.low > 0 else "b"


def compare_levels(cells: Sequence[CellSummary], factors: Sequence[Factor]) -> list[MainEffect]:
    """Return the main effect of each factor.

    There are none unless all combinations of two or more factors have a rate, or the only factor is
    a number with three or more levels. A control that lacks a factor is left out: replay, e.g., has
    no `n_sampled_goal`.
    """
    rated = []
    for cell in cells:
        if cell.success.value is not None and None not in cell.settings.values():
            rated.append(cell)
    n_levels = {}
    for factor in factors:
        n_levels[factor.key] = len({cell.settings[factor.key] for cell in rated})
    n_varied = sum(n > 1 for n in n_levels.values())
    is_series = len(factors) == 1 and factors[0].numeric and n_levels[factors[0].key] > 2
    if n_varied < 2 and not is_series:
        return []

    rates = {}
    for cell in rated:
        rates[tuple(cell.settings[key] for key in n_levels)] = seed_rates(cell)
    # Two cells with equal levels would hide that another combination is missing.
    is_complete = len(rated) == len(rates) == math.prod(n_levels.values())
    most_levels = max(len(factor.levels) for factor in factors)
    if most_levels > MAX_LEVELS or not is_complete:
        return []
    return main_effects(list(n_levels), list(rates.items()))

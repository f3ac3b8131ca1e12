"""The findings of a report, in sentences. `report_warnings` has what limits them."""

from collections.abc import Iterator, Mapping, Sequence

from parking_exp.config.settings import display_setting
from parking_exp.phrases import FEW_NAMES, join_with_and, list_names, quoted_label
from parking_exp.reports.cell_comparisons import judge
from parking_exp.reports.formats import (
    VERDICTS,
    p_in_words,
    percent_interval_in_words,
    points_interval_in_words,
)
from parking_exp.reports.report_data import CellSummary, Pair, ReportData
from parking_exp.statistics import ENOUGH_FOR_A_TEST, Difference

TOO_FEW = f": that needs {ENOUGH_FOR_A_TEST} finished seeds of each."
LEVEL_VERDICTS = {
    "same": "levels are indistinguishable; ",
    "unclear": "levels may differ; ",
    "unknown": "too few seeds; ",
}


def describe_findings(report: ReportData) -> Iterator[str]:
    """Yield the findings of a report, the most important first.

    If several factors are crossed, their effects come first.
    """
    if len(report.effects) > 1:
        yield from _describe_factors(report)
        yield from _describe_cells(report)
    else:
        yield from _describe_cells(report)
        yield from _describe_factors(report)


def _describe_cells(report: ReportData) -> Iterator[str]:
    """Yield the findings on cells: which is better, by how much, how sure."""
    rated = [cell for cell in report.cells if cell.success.value is not None]
    rated.sort(key=lambda cell: (-(cell.success.value or 0.0), cell.failure.value or 0.0))
    if rated:
        yield _describe_best(rated)
        yield from _describe_pairs(_orient_pairs(report, rated[0]), report.labels)
    elif any(cell.counts["done"] for cell in report.cells):
        yield "No finished run has a final success rate."


def _describe_best(rated: Sequence[CellSummary]) -> str:
    best = rated[0]
    if best.success.value == 0 and len(rated) > 1:
        return "No cell succeeds in any episode."
    rate = percent_interval_in_words(best.success)
    seeds = f"mean of {best.success.n} seeds" if best.success.n > 1 else "one seed"
    if len(rated) == 1:
        return f"{quoted_label(best.label)} succeeds in {rate} of the episodes, {seeds}."

    equal = [cell.label for cell in rated if cell.success.value == best.success.value]
    if len(equal) > 1:
        return f"{list_names(equal)} have the same final success, the highest: {rate}."
    name = quoted_label(best.label)
    return f"{name} has the highest final success: {rate} of the episodes, {seeds}."


def _orient_pairs(report: ReportData, best: CellSummary) -> list[Pair]:
    """Return the declared contrasts, or else the pairs with the reference or the best cell.

    In those pairs, that cell comes first.
    """
    if report.declared:
        return list(report.pairs)
    reference = report.reference or best.id
    oriented = []
    for pair in report.pairs:
        if pair.a == reference:
            oriented.append(pair)
        elif pair.b == reference:
            oriented.append(pair.reverse())
    return oriented


def _describe_pairs(pairs: Sequence[Pair], labels: Mapping[str, str]) -> Iterator[str]:
    """Yield a sentence for each first cell and verdict: how the cell compares with others."""
    for first in dict.fromkeys(pair.a for pair in pairs):
        for verdict, words in VERDICTS.items():
            same = [pair for pair in pairs if pair.a == first and pair.verdict == verdict]
            if same:
                yield f"{quoted_label(labels[first])} {words.verb} {_list_others(same, labels)}"


def _list_others(pairs: Sequence[Pair], labels: Mapping[str, str]) -> str:
    """Write the second cells of pairs with the same verdict, the smallest difference first."""
    if pairs[0].verdict == "unknown":
        return list_names([labels[pair.b] for pair in pairs]) + TOO_FEW

    by_size = sorted(pairs, key=lambda pair: abs(pair.difference.value or 0.0))
    gaps = [_write_gap(labels[pair.b], pair.difference) for pair in by_size]
    if len(gaps) > FEW_NAMES:
        return f"{len(gaps)} others, from {gaps[0]} to {gaps[-1]}."
    return f"{join_with_and(gaps)}."


def _write_gap(label: str, difference: Difference) -> str:
    """Write `td3 (+26.1 points [+16.9, +35.4], p = 0.0004)`."""
    p = p_in_words(difference.p_corrected)
    return f"{quoted_label(label)} ({points_interval_in_words(difference)}, {p})"


def _describe_factors(report: ReportData) -> Iterator[str]:
    """Yield what the levels of each crossed factor do."""
    for effect in report.effects_by_size:
        high = effect.highest
        low = effect.lowest
        parts = [points_interval_in_words(effect.largest)]
        if effect.largest.p_corrected is not None:
            parts.append(p_in_words(effect.largest.p_corrected))
        verdict = LEVEL_VERDICTS.get(judge(effect.largest), "")
        high_rate = percent_interval_in_words(high.effect)
        low_rate = percent_interval_in_words(low.effect)
        yield (
            f"{report.factor_names[effect.factor]}: {verdict}{display_setting(high.level)} "
            f"({high_rate}) minus {display_setting(low.level)} "
            f"({low_rate}), averaged over other factors: {', '.join(parts)}."
        )

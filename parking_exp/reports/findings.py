"""The findings of a report, in sentences. `report_warnings` has what limits them."""

from collections.abc import Iterator, Mapping, Sequence

from parking_exp.config.cell_labels import Factor, setting
from parking_exp.errors import quoted_label
from parking_exp.reports.cell_comparisons import SIGNIFICANT, Family
from parking_exp.reports.formats import VERDICTS, p_value, points_interval, rate_interval
from parking_exp.reports.report_data import Cell, Pair
from parking_exp.reports.report_warnings import ENOUGH_SEEDS, FEW_NAMES, list_names
from parking_exp.statistics import MainEffect, Proportion

TOO_FEW = ": that needs two finished seeds of each."


def describe_cells(cells: Sequence[Cell], family: Family) -> Iterator[str]:
    """Yield the findings on cells, the most important first: which is better, by how much, how sure."""
    rated = sorted(
        (cell for cell in cells if cell.success.value is not None),
        key=lambda cell: (-(cell.success.value or 0.0), cell.failure.value or 0.0),
    )
    if not rated:
        if any(cell.counts["done"] for cell in cells):
            yield "No finished run has a final success rate."
        return
    best, rate = rated[0], rate_interval(rated[0].success)
    seeds = f"mean of {best.success.n} seeds" if best.success.n > 1 else "one seed"
    first = [cell.label for cell in rated if cell.success.value == best.success.value]
    if len(rated) == 1:
        yield f"{quoted_label(best.label)} succeeds in {rate} of the episodes, {seeds}."
    elif len(first) > 1:
        yield f"{list_names(first)} have the same final success, the highest: {rate}."
    else:
        yield f"{quoted_label(best.label)} has the highest final success: {rate} of the episodes, {seeds}."
    labels = {cell.id: cell.label for cell in rated}
    if family.declared:
        yield from (_describe_contrast(pair, labels) for pair in family.pairs)
    else:
        reference = next((cell for cell in rated if cell.id == family.reference), best)
        yield from _describe_comparisons(reference, labels, family.pairs)
    if shares := [
        f"{quoted_label(cell.label)} {_write_share(cell.reaching_95)}" for cell in rated if cell.reaching_95.n > 1
    ]:
        yield f"Seeds that end at 95 % or above: {_join_first(shares)}."


def describe_factors(factors: Sequence[Factor], effects: Sequence[MainEffect]) -> Iterator[str]:
    """Yield what the levels of each crossed factor do, where all combinations are there."""
    names = {factor.key: factor.name for factor in factors}
    for effect in effects:
        if not effect.complete or effect.largest is None:
            continue
        high = max(effect.levels, key=lambda level: level.effect.value or 0.0)
        low = min(effect.levels, key=lambda level: level.effect.value or 0.0)
        verdict = "" if effect.p is not None and effect.p < SIGNIFICANT else "levels are indistinguishable; "
        gap = ", ".join(filter(None, (points_interval(effect.largest), p_value(effect.p))))
        yield (
            f"{names[effect.factor]}: {verdict}{setting(high.level)} ({rate_interval(high.effect)}) minus "
            f"{setting(low.level)} ({rate_interval(low.effect)}), averaged over other factors: {gap}."
        )


def _describe_comparisons(reference: Cell, labels: Mapping[str, str], pairs: Sequence[Pair]) -> Iterator[str]:
    """Yield how one cell compares with the others, by verdict: the smallest difference first."""
    with_reference = [pair for pair in pairs if reference.id in (pair.a, pair.b)]
    oriented = [pair if pair.a == reference.id else pair.reverse() for pair in with_reference]
    oriented.sort(key=lambda pair: abs(pair.difference.value or 0.0))
    name = quoted_label(reference.label)
    for verdict, words in VERDICTS.items():
        same = [pair for pair in oriented if pair.verdict == verdict]
        gaps = [_write_gap(labels[pair.b], pair) for pair in same]
        if verdict == "unknown" and same:
            yield f"{name} {words.verb} {list_names([labels[pair.b] for pair in same])}{TOO_FEW}"
        elif len(gaps) > FEW_NAMES:
            yield f"{name} {words.verb} {len(gaps)} others, from {gaps[0]} to {gaps[-1]}."
        elif gaps:
            yield f"{name} {words.verb} {'; '.join(gaps)}."


def _describe_contrast(pair: Pair, labels: Mapping[str, str]) -> str:
    other = labels[pair.b]
    gap = f"{quoted_label(other)}{TOO_FEW}" if pair.verdict == "unknown" else f"{_write_gap(other, pair)}."
    return f"{quoted_label(labels[pair.a])} {VERDICTS[pair.verdict].verb} {gap}"


def _write_gap(label: str, pair: Pair) -> str:
    """Write `td3 (+26.1 points [+16.9, +35.4], p < 0.001)`, and where ranks disagree, their p."""
    p = f", {p_value(pair.p_corrected)}" if pair.p_corrected is not None else ""
    many = pair.difference.n >= ENOUGH_SEEDS  # with fewer, ranks of several pairs can't be significant after Holm
    if many and pair.rank_p_holm is not None and (pair.rank_p_holm < SIGNIFICANT) != (pair.verdict in ("a", "b")):
        p += f", but by ranks {p_value(pair.rank_p_holm)}"
    return f"{quoted_label(label)} ({points_interval(pair.difference)}{p})"


def _join_first(parts: Sequence[str]) -> str:
    more = f"; tables have {len(parts) - FEW_NAMES} more" if len(parts) > FEW_NAMES else ""
    return "; ".join(parts[:FEW_NAMES]) + more


def _write_share(share: Proportion) -> str:
    interval = "" if share.low is None or share.high is None else f" [{100 * share.low:.0f}, {100 * share.high:.0f} %]"
    return f"{share.k} of {share.n}{interval}"

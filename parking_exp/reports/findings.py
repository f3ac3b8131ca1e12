"""The findings of a report, in sentences. `report_warnings` has what limits them."""

from collections.abc import Iterator, Mapping, Sequence

from parking_exp.config.cell_labels import Factor, setting
from parking_exp.errors import quoted_label
from parking_exp.reports.cell_comparisons import SIGNIFICANT, Family
from parking_exp.reports.formats import VERDICTS, p_value, points_interval, rate_interval
from parking_exp.reports.report_data import Cell, Pair
from parking_exp.reports.report_warnings import ENOUGH_SEEDS, FEW_NAMES, list_names
from parking_exp.statistics import MainEffect, Proportion

FAR_BELOW = 0.1  # of success
TOO_FEW = ": that needs two finished seeds of each."


def describe(
    cells: Sequence[Cell], family: Family, factors: Sequence[Factor], effects: Sequence[MainEffect]
) -> Iterator[str]:
    """Yield the findings of a report, the most important first.

    Where several factors are crossed, that is what each of them does.
    """
    if len(effects) > 1:
        yield from _describe_factors(factors, effects)
        yield from _describe_cells(cells, family)
    else:
        yield from _describe_cells(cells, family)
        yield from _describe_factors(factors, effects)


def _describe_cells(cells: Sequence[Cell], family: Family) -> Iterator[str]:
    """Yield the findings on cells: which is better, by how much, how sure."""
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
        yield (
            f"{quoted_label(best.label)} has the highest final success: {rate} of the episodes, "
            f"{seeds}."
        )
    by_id = {cell.id: cell for cell in rated}
    if family.declared:
        yield from (_describe_contrast(by_id[pair.a], by_id[pair.b], pair) for pair in family.pairs)
    else:
        reference = by_id[family.reference] if family.reference else best
        yield from _describe_comparisons(reference, by_id, family.pairs)
    if shares := [
        f"{quoted_label(cell.label)} {_write_share(cell.reaching_95)}"
        for cell in rated
        if cell.reaching_95.n > 1
    ]:
        yield f"Seeds that end at 95 % or above: {_join_first(shares)}."


def _describe_factors(factors: Sequence[Factor], effects: Sequence[MainEffect]) -> Iterator[str]:
    """Yield what the levels of each crossed factor do, where all combinations are there."""
    names = {factor.key: factor.name for factor in factors}
    for effect in sorted(effects, key=lambda effect: effect.size, reverse=True):
        if not effect.complete or effect.largest is None:
            continue
        high, low = effect.extremes
        verdict = (
            ""
            if effect.p is not None and effect.p < SIGNIFICANT
            else "levels are indistinguishable; "
        )
        gap = ", ".join(filter(None, (points_interval(effect.largest), p_value(effect.p))))
        yield (
            f"{names[effect.factor]}: {verdict}{setting(high.level)} "
            f"({rate_interval(high.effect)}) minus "
            f"{setting(low.level)} ({rate_interval(low.effect)}), averaged over other factors: "
            f"{gap}."
        )


def _describe_comparisons(
    reference: Cell, cells: Mapping[str, Cell], pairs: Sequence[Pair]
) -> Iterator[str]:
    """Yield how one cell compares with the others, by verdict: the smallest difference first."""
    with_reference = [pair for pair in pairs if reference.id in (pair.a, pair.b)]
    oriented = [pair if pair.a == reference.id else pair.reverse() for pair in with_reference]
    oriented.sort(key=lambda pair: abs(pair.difference.value or 0.0))
    name = quoted_label(reference.label)
    for verdict, words in VERDICTS.items():
        same = [pair for pair in oriented if pair.verdict == verdict]
        others = [cells[pair.b] for pair in same]
        gaps = [_write_gap(cell, pair) for cell, pair in zip(others, same, strict=True)]
        if verdict == "unknown" and same:
            yield f"{name} {words.verb} {list_names([cell.label for cell in others])}{TOO_FEW}"
        elif len(gaps) > FEW_NAMES:
            lowest = _describe_lowest(reference, others) if verdict == "same" else ""
            yield f"{name} {words.verb} {len(gaps)} others, from {gaps[0]} to {gaps[-1]}.{lowest}"
        elif gaps:
            yield f"{name} {words.verb} {'; '.join(gaps)}."


def _describe_lowest(reference: Cell, others: Sequence[Cell]) -> str:
    """Return a sentence on the lowest of the cells that cannot be told from a reference, if it is
    far below.
    """
    lowest = min(cell.success.value or 0.0 for cell in others)
    cells = [cell for cell in others if cell.success.value == lowest]
    if lowest > (reference.success.value or 0.0) - FAR_BELOW:
        return ""
    names = list_names([cell.label for cell in cells])
    return (
        f" That is not equal: {names} succeed{'s' if len(cells) == 1 else ''} in "
        f"{rate_interval(cells[0].success)}, "
        "and more seeds or fewer pairs (baseline=, contrast=) can tell."
    )


def _describe_contrast(cell: Cell, other: Cell, pair: Pair) -> str:
    gap = (
        f"{quoted_label(other.label)}{TOO_FEW}"
        if pair.verdict == "unknown"
        else f"{_write_gap(other, pair)}."
    )
    return f"{quoted_label(cell.label)} {VERDICTS[pair.verdict].verb} {gap}"


def _write_gap(other: Cell, pair: Pair) -> str:
    """Write `td3 (+26.1 points [+16.9, +35.4], p < 0.001)`, and where ranks disagree, their p."""
    p = f", {p_value(pair.p_corrected)}" if pair.p_corrected is not None else ""
    many = (
        pair.difference.n >= ENOUGH_SEEDS
    )  # with fewer, ranks of several pairs can't be significant after Holm
    if (
        many
        and pair.rank_p_holm is not None
        and (pair.rank_p_holm < SIGNIFICANT) != (pair.verdict in ("a", "b"))
    ):
        p += f", but by ranks {p_value(pair.rank_p_holm)}"
    return f"{quoted_label(other.label)} ({points_interval(pair.difference)}{p})"


def _join_first(parts: Sequence[str]) -> str:
    more = f"; tables have {len(parts) - FEW_NAMES} more" if len(parts) > FEW_NAMES else ""
    return "; ".join(parts[:FEW_NAMES]) + more


def _write_share(share: Proportion) -> str:
    interval = (
        ""
        if share.low is None or share.high is None
        else f" [{100 * share.low:.0f}, {100 * share.high:.0f} %]"
    )
    return f"{share.k} of {share.n}{interval}"

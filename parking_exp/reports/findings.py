"""The findings of a report, in sentences. `warnings` has what stands in the way of them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from parking_exp.errors import plural, quoted_label
from parking_exp.reports.comparisons import SIGNIFICANT, Family
from parking_exp.reports.formats import p_value, points_interval, rate_interval, setting
from parking_exp.reports.report_data import (
    Cell,
    Design,
    Factor,
    Importance,
    Interaction,
    Interval,
    MainEffect,
    Pair,
)
from parking_exp.reports.warnings import FEW_NAMES, named

VERDICTS = {"better": "is better than", "worse": "is worse than", "same": "can't be told apart from"}


class Gap(NamedTuple):
    """The difference of one cell from another, and its p value."""

    label: str
    points: Interval
    p: float | None

    def __str__(self) -> str:
        """Write `td3 (+26.1 points [+16.9, +35.4], Holm's p < 0.001)`."""
        p = f"Holm's {p_value(self.p)}" if self.p is not None else ""
        return f"{quoted_label(self.label)} ({', '.join(filter(None, (points_interval(self.points), p)))})"


def claims(cells: Sequence[Cell], family: Family) -> Iterator[str]:
    """Yield the findings on cells, the most important first: which is better, by how much, how sure, the cost."""
    having = sorted((cell for cell in cells if cell.success.value is not None), key=_rank)
    if not having:
        if any(cell.counts["done"] for cell in cells):
            yield "No finished run has a final success rate."
        return
    best = having[0]
    seeds = f"mean of {best.success.n} seeds" if best.success.n > 1 else "one seed"
    if len(having) == 1:
        yield f"{quoted_label(best.label)} succeeds in {rate_interval(best.success)} of the scenes, {seeds}."
    else:
        first = [cell.label for cell in having if cell.success.value == best.success.value]
        if len(first) > 1:
            yield f"{named(first)} have the same final success, the highest: {rate_interval(best.success)}."
        else:
            rate = rate_interval(best.success)
            yield f"{quoted_label(best.label)} has the highest final success: {rate} of the scenes, {seeds}."
        reference = next((cell for cell in having if cell.id == family.reference), best)
        yield from _against(reference, having, family.pairs)
    yield from _reaching(having)
    yield from _crashes(having)
    yield from _cost(having)


def about_factors(
    design: Design,
    factors: Sequence[Factor],
    effects: Sequence[MainEffect],
    interactions: Sequence[Interaction],
    importance: Sequence[Importance],
) -> Iterator[str]:
    """Yield the findings on single factors."""
    names = {factor.key: factor.name for factor in factors}
    if any(not effect.complete for effect in effects):
        yield "Not all combinations of the factors are there: their levels are means of different cells."
    for effect in effects:
        if effect.complete:
            yield from _effect(effect, names[effect.factor], len(effects) > 1)
    for table in interactions:
        yield from _interaction(table, names[table.row], names[table.column])
    if design == "search":
        yield from _importance(importance, names)


def _importance(importance: Sequence[Importance], names: Mapping[str, str]) -> Iterator[str]:
    """Yield which hyperparameters matter; p is corrected (Bonferroni) for how many were looked at."""
    shown = [one for one in importance if one.p is not None and one.p * len(importance) < SIGNIFICANT]
    for one in shown:
        way = "" if not one.direction else ", larger is better" if one.direction > 0 else ", smaller is better"
        yield (
            f"{names[one.factor]} alone explains {100 * one.share:.0f} % of the variance of success between cells "
            f"({p_value(one.p)}{way})."
        )
    if importance and not shown:
        yield "No hyperparameter can be shown to matter by itself."
    if importance:
        yield "The best of a search was chosen by its result: run it on other seeds before its rate is believed."


def _effect(effect: MainEffect, name: str, several: bool) -> Iterator[str]:
    known = [level for level in effect.levels if level.effect.value is not None]
    if len(known) < 2 or effect.largest is None:
        return
    high = max(known, key=lambda level: level.effect.value or 0.0)
    low = min(known, key=lambda level: level.effect.value or 0.0)
    p = f", {p_value(effect.p)}" if effect.p is not None else ""
    gap, over = f"{points_interval(effect.largest)}{p}", ", on average over the other factors" if several else ""
    if effect.p is not None and effect.p < SIGNIFICANT:
        yield (
            f"{name}: {setting(high.level)} ({rate_interval(high.effect)}) is better than {setting(low.level)} "
            f"({rate_interval(low.effect)}){over}: {gap}."
        )
    elif high.level != low.level:
        yield (
            f"{name}: levels can't be told apart{over}; the largest difference is {setting(high.level)} less "
            f"{setting(low.level)}, {gap}."
        )


def _interaction(table: Interaction, row: str, column: str) -> Iterator[str]:
    rest = [(abs(r), r, i, j) for i, line in enumerate(table.residual) for j, r in enumerate(line) if r is not None]
    if len(rest) < 4 or table.p is None:
        return
    size, residual, i, j = max(rest)
    given, p = (f" ({table.given})" if table.given else ""), p_value(table.p)
    if table.p < SIGNIFICANT:
        yield (
            f"{row} and {column} do not just add up{given} (F test, {p}): {setting(table.rows[i])} with {column}="
            f"{setting(table.columns[j])} is {100 * residual:+.1f} points from what both would give alone."
        )
    else:
        yield (
            f"{row} and {column} add up{given}, as far as can be told (F test, {p}): no combination is more than "
            f"{100 * size:.1f} points from it."
        )


def _rank(cell: Cell) -> tuple[float, float]:
    return -(cell.success.value or 0.0), cell.crash.value or 0.0


def _against(reference: Cell, having: Sequence[Cell], pairs: Sequence[Pair]) -> Iterator[str]:
    """Compare one cell with all others."""
    labels = {cell.id: cell.label for cell in having}
    verdicts: dict[str, list[Gap]] = {word: [] for word in (*VERDICTS, "unknown")}
    for pair in pairs:
        if reference.id in (pair.a, pair.b):
            ours = pair if pair.a == reference.id else pair.turned()
            verdict = {"a": "better", "b": "worse"}.get(ours.verdict, ours.verdict)
            verdicts[verdict].append(Gap(labels[ours.b], ours.difference, ours.p_holm))
    for verdict, words in VERDICTS.items():
        if found := sorted(verdicts[verdict], key=lambda gap: abs(gap.points.value or 0.0)):
            yield f"{quoted_label(reference.label)} {words} {_gaps(found)}."
    if found := verdicts["unknown"]:
        names = named([gap.label for gap in found])
        name = quoted_label(reference.label)
        yield f"Whether {name} differs from {names} can't be told: that takes two finished seeds of each."


def _gaps(found: Sequence[Gap]) -> str:
    """List all differences, or say how many there are and name the smallest and the largest."""
    if len(found) <= FEW_NAMES:
        return "; ".join(map(str, found))
    return f"{len(found)} others, from {found[0]} to {found[-1]}"


def _first(parts: Sequence[str]) -> str:
    more = f"; tables have {len(parts) - FEW_NAMES} more" if len(parts) > FEW_NAMES else ""
    return "; ".join(parts[:FEW_NAMES]) + more


def _reaching(having: Sequence[Cell]) -> Iterator[str]:
    known = [cell for cell in having if cell.reaching_90.n > 1]
    if known:
        parts = [
            f"{quoted_label(cell.label)} {cell.reaching_90.k} of {cell.reaching_90.n}" + _wilson(cell) for cell in known
        ]
        yield f"Seeds that end at 90 % or above: {_first(parts)}."


def _wilson(cell: Cell) -> str:
    low, high = cell.reaching_90.low, cell.reaching_90.high
    return "" if low is None or high is None else f" [{100 * low:.0f}, {100 * high:.0f} %]"


def _crashes(having: Sequence[Cell]) -> Iterator[str]:
    known = sorted((cell for cell in having if cell.crash.value is not None), key=lambda c: c.crash.value or 0.0)
    if known:
        least, most = known[0], known[-1]
        if least.crash.value == most.crash.value:
            yield f"Crashes end {rate_interval(most.crash)} of the episodes."
        else:
            low, high = (f"{rate_interval(cell.crash)} ({quoted_label(cell.label)})" for cell in (least, most))
            yield f"Crashes end {low} to {high} of the episodes."


def _cost(having: Sequence[Cell]) -> Iterator[str]:
    known = sorted((cell for cell in having if cell.cpu_s.value is not None), key=lambda c: c.cpu_s.value or 0.0)
    if known:
        least, most = known[0], known[-1]
        low, high = (f"{cell.cpu_s.value:,.0f}" for cell in (least, most))
        some = f"{low} ({quoted_label(least.label)}) to {high} ({quoted_label(most.label)})" if low != high else low
        yield f"A run took {some} CPU-seconds on average."
    times = [f"{quoted_label(cell.label)} {_median(cell)}" for cell in having if cell.survival and cell.survival.n > 1]
    if times:
        yield f"Median time to hold 90 %: {_first(times)}."


def _median(cell: Cell) -> str:
    assert cell.survival is not None
    if cell.survival.median is None:
        return f"unknown ({cell.survival.k} of {plural(cell.survival.n, 'seed')} did)"
    cpu_s = cell.survival_cpu.median if cell.survival_cpu else None
    return f"{cell.survival.median:,.0f} env steps" + ("" if cpu_s is None else f", {cpu_s:,.0f} CPU-seconds")

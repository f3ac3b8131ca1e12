"""The findings of a report, in sentences. `warnings` has what limits them."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from parking_exp.config.cell_labels import Factor
from parking_exp.errors import plural, quoted_label
from parking_exp.reports.cell_comparisons import SIGNIFICANT, Family
from parking_exp.reports.formats import p_value, points_interval, rate_interval, setting
from parking_exp.reports.report_data import Cell, Interaction, Pair, Survival
from parking_exp.reports.warnings import FEW_NAMES, named
from parking_exp.statistics import Interval, MainEffect, Proportion
from parking_exp.tasks.registry import FAILURES

VERDICTS = {"a": "is better than", "b": "is worse than", "same": "is indistinguishable from"}


def about_cells(cells: Sequence[Cell], family: Family) -> Iterator[str]:
    """Yield the findings on cells, the most important first: which is better, by how much, how sure, the cost."""
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
        yield f"{named(first)} have the same final success, the highest: {rate}."
    else:
        yield f"{quoted_label(best.label)} has the highest final success: {rate} of the episodes, {seeds}."
    reference = next((cell for cell in rated if cell.id == family.reference), best)
    yield from _comparisons(reference, {cell.id: cell.label for cell in rated}, family.pairs)
    if shares := [f"{quoted_label(cell.label)} {_at_90(cell.reaching_90)}" for cell in rated if cell.reaching_90.n > 1]:
        yield f"Seeds that end at 90 % or above: {_first(shares)}."
    for name in FAILURES:
        means = {cell.label: cell.further[name] for cell in rated if name in cell.further}
        yield from _range(f"Episodes that end in {name}: {{}}.", means, rate_interval)
    yield from _range(
        "A run took {} CPU-seconds on average.",
        {cell.label: cell.cpu_s for cell in rated},
        lambda cpu_s: f"{cpu_s.value:,.0f}",
    )
    timed = [(cell, cell.survival) for cell in rated if cell.survival and cell.survival.n > 1]
    if times := [f"{quoted_label(cell.label)} {_median(steps, cell.survival_cpu)}" for cell, steps in timed]:
        yield f"Median time to hold 90 %: {_first(times)}."


def about_factors(
    factors: Sequence[Factor],
    effects: Sequence[MainEffect],
    interactions: Sequence[Interaction],
    *,
    is_search: bool,
) -> Iterator[str]:
    """Yield the findings on single factors."""
    names = {factor.key: factor.name for factor in factors}
    if any(not effect.complete for effect in effects):
        yield "Not all combinations of the factors are there: their levels are means of different cells."
    for effect in effects:
        if effect.complete and effect.largest is not None:
            yield from _effect(effect, effect.largest, names[effect.factor], len(effects) > 1)
    for table in interactions:
        yield from _interaction(table, names[table.row], names[table.column])
    if is_search:
        yield "The best of a search was selected by its result: train it on other seeds before relying on its rate."


def _effect(effect: MainEffect, largest: Interval, name: str, several: bool) -> Iterator[str]:
    high = max(effect.levels, key=lambda level: level.effect.value or 0.0)
    low = min(effect.levels, key=lambda level: level.effect.value or 0.0)
    gap = ", ".join(filter(None, (points_interval(largest), p_value(effect.p))))
    over = ", on average over the other factors" if several else ""
    if effect.p is not None and effect.p < SIGNIFICANT:
        yield (
            f"{name}: {setting(high.level)} ({rate_interval(high.effect)}) is better than {setting(low.level)} "
            f"({rate_interval(low.effect)}){over}: {gap}."
        )
    elif high.level != low.level:
        yield (
            f"{name}: levels are indistinguishable{over}; the largest difference is {setting(high.level)} minus "
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
            f"{row} and {column} interact{given} (F test, {p}): {setting(table.rows[i])} with {column}="
            f"{setting(table.columns[j])} is {100 * residual:+.1f} points from the sum of both effects."
        )
    else:
        yield (
            f"{row} and {column} have no significant interaction{given} (F test, {p}): no combination is more than "
            f"{100 * size:.1f} points from the sum of both effects."
        )


def _comparisons(reference: Cell, labels: Mapping[str, str], pairs: Sequence[Pair]) -> Iterator[str]:
    """Yield how one cell compares with the others, by verdict: the smallest difference first."""
    own = [pair if pair.a == reference.id else pair.reversed() for pair in pairs if reference.id in (pair.a, pair.b)]
    own.sort(key=lambda pair: abs(pair.difference.value or 0.0))
    name = quoted_label(reference.label)
    for verdict, words in VERDICTS.items():
        if gaps := [_gap(labels[pair.b], pair) for pair in own if pair.verdict == verdict]:
            many = len(gaps) > FEW_NAMES
            others = f"{len(gaps)} others, from {gaps[0]} to {gaps[-1]}" if many else "; ".join(gaps)
            yield f"{name} {words} {others}."
    unknown = {pair.b for pair in own if pair.verdict == "unknown"}
    if names := [label for cell, label in labels.items() if cell in unknown]:
        yield f"{name} cannot be compared with {named(names)}: that needs two finished seeds of each."


def _gap(label: str, pair: Pair) -> str:
    """Write `td3 (+26.1 points [+16.9, +35.4], Holm's p < 0.001)`."""
    p = f", Holm's {p_value(pair.p_holm)}" if pair.p_holm is not None else ""
    return f"{quoted_label(label)} ({points_interval(pair.difference)}{p})"


def _first(parts: Sequence[str]) -> str:
    more = f"; tables have {len(parts) - FEW_NAMES} more" if len(parts) > FEW_NAMES else ""
    return "; ".join(parts[:FEW_NAMES]) + more


def _at_90(share: Proportion) -> str:
    interval = "" if share.low is None or share.high is None else f" [{100 * share.low:.0f}, {100 * share.high:.0f} %]"
    return f"{share.k} of {share.n}{interval}"


def _range(sentence: str, means: Mapping[str, Interval], write: Callable[[Interval], str]) -> Iterator[str]:
    """Yield a sentence on the lowest and the highest of the known means, given by label."""
    known = {label: mean for label, mean in means.items() if mean.value is not None}
    if known:
        ordered = sorted(known, key=lambda label: known[label].value or 0.0)
        low, high = (write(known[label]) for label in (ordered[0], ordered[-1]))
        both = f"{low} ({quoted_label(ordered[0])}) to {high} ({quoted_label(ordered[-1])})"
        yield sentence.format(both if low != high else low)


def _median(steps: Survival, cpu_s: Survival | None) -> str:
    if steps.median is None:
        return f"unknown ({steps.k} of {plural(steps.n, 'seed')} did)"
    seconds = "" if cpu_s is None or cpu_s.median is None else f", {cpu_s.median:,.0f} CPU-seconds"
    return f"{steps.median:,.0f} env steps{seconds}"

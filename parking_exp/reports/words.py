"""A report's numbers in sentences: what they show, what makes them hard to compare, what is missing."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from parking_exp.reports.content import (
    Cell,
    Design,
    Factor,
    FailedRun,
    Importance,
    Interaction,
    Interval,
    MainEffect,
    Pair,
    Provenance,
)
from parking_exp.reports.factors import shown
from parking_exp.reports.formats import p_value, points_interval, rate_interval
from parking_exp.reports.pairs import SIGNIFICANT
from parking_exp.reports.selection import Group

ENOUGH_SEEDS = 10
FEW_NAMES = 4
VERDICTS = {"better": "is better than", "worse": "is worse than", "same": "can't be told apart from"}


def named(names: Sequence[str]) -> str:
    """List names, the first few of many."""
    few = list(names[:FEW_NAMES])
    comma = "; " if any("," in name for name in few) else ", "
    if len(names) > FEW_NAMES:
        return f"{comma.join(few)} and {len(names) - FEW_NAMES} more"
    return few[0] if len(few) == 1 else f"{comma.join(few[:-1])} and {few[-1]}"


class Gap(NamedTuple):
    """How far a cell is from another one, and the p of that."""

    label: str
    points: Interval
    p: float | None

    def __str__(self) -> str:
        """Write `td3 (+26.1 points [+16.9, +35.4], p < 0.001)`."""
        return f"{self.label} ({', '.join(filter(None, (points_interval(self.points), p_value(self.p))))})"


def claims(cells: Sequence[Cell], pairs: Sequence[Pair], baseline: str | None) -> Iterator[str]:
    """Yield what the comparison shows, the most important first: which is better, by how much, how sure, the cost."""
    having = sorted((cell for cell in cells if cell.success.value is not None), key=_rank)
    if not having:
        return
    best = having[0]
    seeds = f"mean of {best.success.n} seeds" if best.success.n > 1 else "one seed"
    if len(having) == 1:
        yield f"{best.label} succeeds in {rate_interval(best.success)} of the scenes, {seeds}."
    else:
        yield f"{best.label} has the highest final success: {rate_interval(best.success)} of the scenes, {seeds}."
        reference = next((cell for cell in having if cell.id == baseline), best)
        yield from _against(reference, having, pairs)
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
    """Yield what single factors do."""
    names = {factor.key: factor.name for factor in factors}
    for effect in effects:
        yield from _effect(effect, names[effect.factor])
    for table in interactions:
        yield from _interaction(table, names[table.row], names[table.column])
    for one in importance[:3] if design == "search" else ():
        sign = {True: ", larger is better", False: ", smaller is better", None: ""}
        way = sign[None if one.direction is None or not one.direction else one.direction > 0]
        yield (
            f"{names[one.factor]} alone explains {100 * one.share:.0f} % of the variance of success between cells "
            f"({p_value(one.p)}{way})."
        )


def _effect(effect: MainEffect, name: str) -> Iterator[str]:
    known = [level for level in effect.levels if level.effect.value is not None]
    if len(known) < 2 or effect.largest is None:
        return
    high = max(known, key=lambda level: level.effect.value or 0.0)
    low = min(known, key=lambda level: level.effect.value or 0.0)
    p = f", {p_value(effect.p)}" if effect.p is not None else ""
    gap = f"{points_interval(effect.largest)}{p}"
    if effect.p is not None and effect.p < SIGNIFICANT:
        yield (
            f"{name}: {shown(high.level)} ({rate_interval(high.effect)}) is better than {shown(low.level)} "
            f"({rate_interval(low.effect)}), on average over the other factors: {gap}."
        )
    else:
        yield (
            f"{name}: levels can't be told apart, on average over the other factors; the largest difference is "
            f"{shown(high.level)} less {shown(low.level)}, {gap}."
        )


def _interaction(table: Interaction, row: str, column: str) -> Iterator[str]:
    rest = [(abs(r), r, i, j) for i, line in enumerate(table.residual) for j, r in enumerate(line) if r is not None]
    if len(rest) < 4 or table.p is None:
        return
    size, residual, i, j = max(rest)
    given, p = (f" ({table.given})" if table.given else ""), p_value(table.p)
    if table.p < SIGNIFICANT:
        yield (
            f"{row} and {column} do not just add up{given} (F test, {p}): {shown(table.rows[i])} with {column}="
            f"{shown(table.columns[j])} is {100 * residual:+.1f} points from what both would give alone."
        )
    else:
        yield (
            f"{row} and {column} add up{given}, as far as can be told (F test, {p}): no combination is more than "
            f"{100 * size:.1f} points from it."
        )


def warnings(groups: Sequence[Group], cells: Sequence[Cell], origin: Provenance) -> Iterator[str]:
    """Yield what makes numbers hard to compare."""
    few = [cell for cell in cells if cell.success.n < ENOUGH_SEEDS]
    if few:
        number = min(cell.success.n for cell in few)
        yield (
            f"Exploratory: {_of(len(few), len(cells), 'cell')} fewer than {ENOUGH_SEEDS} finished seeds "
            f"(the fewest: {number})."
        )
    yield from _mixed(groups, origin)
    yield from _notes(cells)
    for group in groups:
        if group.repeated:
            yield f"{group.label}: {_runs(group.repeated)} left out, since another one has the same seed."
        if len(blank := group.done[group.done["success_rate"].isna()]):
            yield f"{group.label}: {_runs(len(blank))} finished without a final success rate, and left out."


def missing(cells: Sequence[Cell], unheard: Sequence[FailedRun]) -> Iterator[str]:
    """Yield which runs have no result.

    Args:
        cells: of the report.
        unheard: runs that the store has not heard of.
    """
    total: Counter[str] = Counter()
    for cell in cells:
        total.update(cell.counts)
    not_begun = sum(run.status == "pending" for run in unheard)
    total.update(run.status for run in unheard if run.status != "pending")
    waiting = {"running": "under way", "failed": "failed", "pending": "cut off or waiting"}
    found = [f"{total[stage]} {words}" for stage, words in waiting.items() if total[stage]]
    if not_begun:
        found.append(f"{not_begun} not begun")
    if found:
        everything = sum(total.values()) + not_begun
        yield f"{total['done']} of {everything} runs are done: {', '.join(found)}."
    if empty := [cell.label for cell in cells if not cell.counts["done"]]:
        yield f"No run is done of {named(empty)}."
    whole = [cell for cell in cells if cell.counts["done"]]
    most = max((cell.counts["done"] for cell in whole), default=0)
    if behind := [cell.label for cell in whole if cell.counts["done"] < most]:
        yield f"Fewer than {most} seeds are done of {named(behind)}."


def _rank(cell: Cell) -> tuple[float, float]:
    return -(cell.success.value or 0.0), cell.crash.value or 0.0


def _against(reference: Cell, having: Sequence[Cell], pairs: Sequence[Pair]) -> Iterator[str]:
    """Compare one cell with all others."""
    labels = {cell.id: cell.label for cell in having}
    verdicts: dict[str, list[Gap]] = {word: [] for word in (*VERDICTS, "unknown")}
    for pair in pairs:
        if reference.id not in (pair.a, pair.b):
            continue
        first = pair.a == reference.id
        other = labels[pair.b if first else pair.a]
        verdict = pair.verdict if pair.verdict in {"same", "unknown"} else _better(pair.verdict, first)
        verdicts[verdict].append(Gap(other, pair.difference if first else _turned(pair.difference), pair.p_holm))
    for verdict, words in VERDICTS.items():
        if found := sorted(verdicts[verdict], key=lambda gap: abs(gap.points.value or 0.0)):
            yield f"{reference.label} {words} {_gaps(found)}."
    if found := verdicts["unknown"]:
        names = named([gap.label for gap in found])
        yield f"Whether {reference.label} differs from {names} can't be told: that takes two finished seeds of each."


def _gaps(found: Sequence[Gap]) -> str:
    """List all differences, or say how many there are and name the smallest and the largest."""
    if len(found) <= FEW_NAMES:
        return "; ".join(map(str, found))
    return f"{len(found)} others, from {found[0]} to {found[-1]}"


def _better(verdict: str, first: bool) -> str:
    return "better" if (verdict == "a") == first else "worse"


def _turned(gap: Interval) -> Interval:
    low, high = (None if bound is None else -bound for bound in (gap.high, gap.low))
    return Interval(None if gap.value is None else -gap.value, low, high, gap.n, gap.method)


def _reaching(having: Sequence[Cell]) -> Iterator[str]:
    several = [cell for cell in having if cell.reaching_90.n > 1][:FEW_NAMES]
    if several:
        parts = [f"{cell.label} {cell.reaching_90.k} of {cell.reaching_90.n}" + _wilson(cell) for cell in several]
        yield f"Seeds that end at 90 % or above: {'; '.join(parts)}."


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
            low, high = (f"{rate_interval(cell.crash)} ({cell.label})" for cell in (least, most))
            yield f"Crashes end {low} to {high} of the episodes."


def _cost(having: Sequence[Cell]) -> Iterator[str]:
    known = sorted((cell for cell in having if cell.cpu_s.value is not None), key=lambda c: c.cpu_s.value or 0.0)
    if known:
        least, most = known[0], known[-1]
        low, high = (f"{cell.cpu_s.value:,.0f}" for cell in (least, most))
        some = f"{low} ({least.label}) to {high} ({most.label})" if low != high else low
        yield f"A run took {some} CPU-seconds on average."
    times = [f"{cell.label} {_median(cell)}" for cell in having if cell.survival and cell.survival.n > 1]
    if times:
        yield f"Median time to hold 90 %: {'; '.join(times[:FEW_NAMES])}."


def _median(cell: Cell) -> str:
    assert cell.survival is not None
    if cell.survival.median is None:
        return f"unknown ({cell.survival.k} of {cell.survival.n} seeds did)"
    cpu_s = cell.survival_cpu.median if cell.survival_cpu else None
    return f"{cell.survival.median:,.0f} env steps" + ("" if cpu_s is None else f", {cpu_s:,.0f} CPU-seconds")


def _mixed(groups: Sequence[Group], origin: Provenance) -> Iterator[str]:
    mixed = {package: list(found) for package, found in origin.versions.items() if len(found) > 1}
    for package, found in mixed.items():
        yield f"Versions are mixed: {package} {named(found)}."
    if len(origin.commits) > 1:
        yield f"Commits are mixed: {named(list(origin.commits))}."
    if any(commit.endswith("+") for commit in origin.commits):
        yield "Some runs were made from files that differ from their commit (marked +)."
    if len(origin.machines) > 1:
        yield f"Machines are mixed, so that CPU-seconds do not compare: {named(list(origin.machines))}."
    for key, words in (
        ("total_timesteps", "Budgets are mixed: cells were trained for {} env steps."),
        ("evaluation.final_n_scenes", "Scene sets are mixed: final models were evaluated on {} scenes."),
        ("evaluation.first_scene", "Scene sets are mixed: they begin at scenes {}."),
        ("env.name", "Tasks are mixed: cells belong to the envs {}; their rates are not of the same scenes."),
    ):
        values = list(dict.fromkeys(group.config.get(key) for group in groups))
        if len(values) > 1:
            yield words.format(named([f"{v:,}" if isinstance(v, int) else shown(v) for v in values]))
    seeds = {tuple(group.done["seed"]) for group in groups if len(group.done)}
    if len(seeds) > 1:
        yield "Cells do not have the same seeds."


def _notes(cells: Sequence[Cell]) -> Iterator[str]:
    notes: dict[str, list[str]] = {}
    for cell in cells:
        if cell.note:
            notes.setdefault(cell.note, []).append(cell.label)
    for note, labels in notes.items():
        yield f"{named(labels)}: {note}"


def _of(k: int, n: int, what: str) -> str:
    if k == n:
        return f"the {what} has" if n == 1 else f"all {n} {what}s have"
    return f"{k} of {n} {what}s {'has' if k == 1 else 'have'}"


def _runs(number: int) -> str:
    return "a run was" if number == 1 else f"{number} runs were"


def together(*parts: Iterable[str]) -> list[str]:
    """Return all sentences, each once."""
    return list(dict.fromkeys(sentence for part in parts for sentence in part))

"""The report's tables as they are read: the same columns and words on the page, in Markdown and in LaTeX."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from parking_exp.reports import formats
from parking_exp.reports.data import Cell, Content, Interaction, Interval, Setting, Share, Survival
from parking_exp.reports.summaries import FURTHER, REPORTED

PERCENT = "with 95 % intervals over seeds in brackets"


class Entry(NamedTuple):
    """What stands in one place of a table.

    Attributes:
        text: what is read; empty where nothing is known.
        value: what it is sorted by; None comes last.
        bar: (low, value, high) in 0 ... 1 for a small picture; low and high may be None.
        cell: id of the cell that it names.
    """

    text: str
    value: float | str | None = None
    bar: tuple[float | None, float, float | None] | None = None
    cell: str | None = None


class Column(NamedTuple):
    """A column's heading, and whether it holds numbers."""

    title: str
    numeric: bool = False


@dataclass(frozen=True)
class Listing:
    """A table to be read.

    Attributes:
        name: for anchors and files.
        caption: one sentence: what it shows.
        rows: each as long as `columns`.
    """

    name: str
    caption: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Entry]]


def listings(content: Content, cells: Collection[str] | None = None) -> dict[str, Listing]:
    """Return every table that has rows, by name; about these cells alone where they are given.

    Names: `headline`, `times`, `pairs`, `effects`, `interactions`, `interactions-2` ..., `importance`, `seeds`,
    `config`, `common`, `versions`, `unfinished`.
    """
    wanted = {cell.id for cell in content.cells} if cells is None else set(cells)
    made = [
        headline(content, wanted),
        times(content, wanted),
        pairs(content, wanted),
        effects(content),
        *(interaction(table, number) for number, table in enumerate(content.interactions, start=1)),
        importance(content),
        seeds(content, wanted),
        config(content, wanted),
        common(content),
        versions(content),
        unfinished(content),
    ]
    return {listing.name: listing for listing in made if listing.rows}


def headline(content: Content, wanted: Collection[str]) -> Listing:
    """Return a row for each cell: what it reached and what it cost."""
    cells = [cell for cell in content.cells if cell.id in wanted]
    timed = any(cell.survival for cell in cells)
    rows = []
    for cell in cells:
        row = [_name(cell), _runs(cell), _rate(cell.success)]
        row += [_rate(rate, bar=False) for rate in (cell.parked, cell.crash, cell.timeout)]
        row.append(_reaching(cell.reaching_90))
        if timed:
            row.append(_time(cell.survival))
        row += [_number(cell.episode_steps, 1), _whole(cell.total_timesteps), _number(cell.cpu_s)]
        rows.append([*row, *(_further(cell.further[name], name) for name in FURTHER)])
    titles = [REPORTED[name].heading for name in ("success", "parked", "crash", "timeout")] + ["Seeds ≥ 90 %"]
    titles += ["Steps to hold 90 %"] if timed else []
    titles += [REPORTED["episode_steps"].heading, "Env steps", "CPU (s)"]
    titles += [REPORTED[name].heading for name in FURTHER]
    return Listing(
        "headline",
        f"Final evaluation: means over seeds, {PERCENT}; how many seeds ended at 90 % or above, with Wilson's interval "
        f"of their share{'; median of the env steps until 90 % were held for three evaluations' if timed else ''}.",
        [Column("Cell"), Column("Seeds", numeric=True), *(Column(title, numeric=True) for title in titles)],
        rows,
    )


VERDICTS = {"same": "can't be told apart", "unknown": "too few seeds to tell"}


def times(content: Content, wanted: Collection[str]) -> Listing:
    """Return a row for each cell: how long it took to hold 90 %, and the area under its curve."""
    cells = [cell for cell in content.cells if cell.id in wanted and cell.survival]
    clocks = [("steps", [cell.survival for cell in cells]), ("CPU-s", [cell.survival_cpu for cell in cells])]
    titles = ["Reached"]
    rows = [[_name(cell), Entry(f"{cell.survival.k}/{cell.survival.n}")] for cell in cells if cell.survival]
    for unit, found in clocks:
        horizon = next((one.horizon for one in found if one and one.horizon), None)
        titles += [f"Median ({unit})", f"Mean up to {formats.number(horizon)} ({unit})"]
        for row, survival in zip(rows, found, strict=True):
            row += [_time(survival), _counted(survival.restricted_mean if survival else Interval(None))]
    for row, cell in zip(rows, cells, strict=True):
        row.append(_rate(cell.area, bar=False))
    return Listing(
        "times",
        "Time until three evaluations in a row have 90 %, with the mean up to a time that all seeds were watched; area "
        f"under the learning curve in % of the highest possible; means {PERCENT}.",
        [Column("Cell"), *(Column(title, numeric=True) for title in [*titles, "Area (%)"])],
        rows,
    )


def pairs(content: Content, wanted: Collection[str]) -> Listing:
    """Return a row for each pair that was compared."""
    by_id = {cell.id: cell for cell in content.cells}
    rows = []
    for pair in content.pairs:
        if pair.a in wanted and pair.b in wanted:
            a, b = by_id[pair.a], by_id[pair.b]
            better = {"a": a, "b": b}.get(pair.verdict)
            verdict = VERDICTS.get(pair.verdict) or f"{better.label if better else '?'} is better"
            chance, value = pair.improvement, formats.rate(pair.difference)
            row = [_name(a), _name(b), Entry(formats.percent_interval(pair.difference, signed=True), value)]
            row += [_p(pair.p_holm), Entry(formats.percent_interval(chance), formats.rate(chance))]
            rows.append([*row, _p(pair.log_rank_p_holm), Entry(verdict, verdict)])
    titles = ["A − B (points)", "p (Holm)", "A better than B (%)", "p, time to 90 % (Holm)"]  # noqa: RUF001
    return Listing(
        "pairs",
        "Pairs of cells: difference of mean final success in percentage points, with 95 % interval; probability that a "
        "seed of A is better than one of B.",
        [Column("A"), Column("B"), *(Column(title, numeric=True) for title in titles), Column("In words")],
        rows,
    )


def effects(content: Content) -> Listing:
    """Return a row for each level of each factor."""
    rows = [
        [Entry(effect.factor, effect.factor), _setting(level.level), _rate(level.effect), _whole(level.cells)]
        for effect in content.effects
        for level in effect.levels
    ]
    return Listing(
        "effects",
        f"Main effects: mean final success at each level over the levels of the other factors, {PERCENT}.",
        [Column("Factor"), Column("Level"), Column("Success (%)", numeric=True), Column("Cells", numeric=True)],
        rows,
    )


def interaction(table: Interaction, number: int) -> Listing:
    """Return two factors crossed."""
    rows = []
    for i, level in enumerate(table.rows):
        spreads = [
            Interval(*values, n=table.n[i][j])
            for j, values in enumerate(zip(table.mean[i], table.low[i], table.high[i], strict=True))
        ]
        rows.append([_setting(level), *(_rate(spread, bar=False) for spread in spreads)])
    if table.real_share:
        shares = [Entry(formats.percent(share), formats.finite(share)) for share in table.real_share]
        rows.append([Entry("real transitions (%)"), *shares])
    given = f" for {table.given}" if table.given else ""
    return Listing(
        "interactions" if number == 1 else f"interactions-{number}",
        f"Mean final success (%) by {table.row} (rows) and {table.column} (columns){given}, {PERCENT}.",
        [Column(table.row), *(Column(formats.level(level), numeric=True) for level in table.columns)],
        rows,
    )


def importance(content: Content) -> Listing:
    """Return a row for each hyperparameter."""
    rows = [
        [
            Entry(found.factor, found.factor),
            Entry(formats.percent(found.share), found.share, bar=(None, found.share, None)),
            Entry(_signed(found.direction), formats.finite(found.direction)),
            _p(found.p),
        ]
        for found in content.importance
    ]
    titles = ["Variance explained alone (%)", "Rank correlation", "p (permutations)"]
    return Listing(
        "importance",
        "Hyperparameters: share of the variance of final success that each explains alone.",
        [Column("Hyperparameter"), *(Column(title, numeric=True) for title in titles)],
        rows,
    )


def seeds(content: Content, wanted: Collection[str]) -> Listing:
    """Return a row for each finished run."""
    rows = []
    for cell in content.cells:
        for seed in cell.seeds if cell.id in wanted else ():
            reached = formats.number(seed.steps_to_90)
            spread = Interval(seed.success, seed.low, seed.high)
            row = [_name(cell), Entry(str(seed.seed), seed.seed), _rate(spread)]
            row += [Entry(formats.percent(rate), formats.finite(rate)) for rate in (seed.parked, seed.crash)]
            row += [Entry(formats.percent(seed.timeout), formats.finite(seed.timeout)), _whole(seed.n_scenes)]
            row += [
                Entry(reached if seed.reached_90 or not reached else f"> {reached}", formats.finite(seed.steps_to_90))
            ]
            row += [Entry(formats.number(seed.cpu_s), formats.finite(seed.cpu_s)), Entry(seed.run_id, seed.run_id)]
            rows.append(row)
    titles = ["Seed", "Success (%)", "Parked (%)", "Crash (%)", "Timeout (%)", "Scenes", "Steps to 90 %", "CPU (s)"]
    return Listing(
        "seeds",
        "Finished runs: final rates over the certified scenes, with Wilson's 95 % interval in brackets.",
        [Column("Cell"), *(Column(title, numeric=True) for title in titles), Column("Run")],
        rows,
    )


def config(content: Content, wanted: Collection[str]) -> Listing:
    """Return the settings that are not the same in all cells: the longer of cells and keys goes down the page."""
    difference = content.provenance.difference
    cells = [(position, cell) for position, cell in enumerate(content.cells) if cell.id in wanted]
    caption = "Settings that are not the same in all cells."
    if len(cells) > len(difference) and difference:
        rows = [
            [_name(cell), *(_setting(values[position]) for values in difference.values())] for position, cell in cells
        ]
        return Listing("config", caption, [Column("Cell"), *(Column(key) for key in difference)], rows)
    rows = [
        [Entry(key, key), *(_setting(values[position]) for position, _ in cells)] for key, values in difference.items()
    ]
    return Listing("config", caption, [Column("Setting"), *(Column(cell.label) for _, cell in cells)], rows)


def common(content: Content) -> Listing:
    """Return the settings that are the same in all cells."""
    rows = [[Entry(key, key), _setting(value)] for key, value in content.provenance.common.items()]
    return Listing("common", "Settings that are the same in all cells.", [Column("Setting"), Column("Value")], rows)


def versions(content: Content) -> Listing:
    """Return versions, commits and machines, with the number of runs of each."""
    found = content.provenance
    names = [
        (package, version, runs) for package, all_of_it in found.versions.items() for version, runs in all_of_it.items()
    ]
    names += [("commit", name, runs) for name, runs in found.commits.items()]
    names += [("machine", name, runs) for name, runs in found.machines.items()]
    rows = [[Entry(what, what), Entry(which, which), _whole(runs)] for what, which, runs in names]
    columns = [Column("What"), Column("Version"), Column("Runs", numeric=True)]
    return Listing("versions", "Versions, commits and machines.", columns, rows)


def unfinished(content: Content) -> Listing:
    """Return the runs without a result, and why."""
    rows = [
        [Entry(run.label, run.label), Entry(str(run.seed), run.seed), Entry(run.status, run.status), Entry(run.reason)]
        for run in content.provenance.unfinished
    ]
    columns = [Column("Cell"), Column("Seed", numeric=True), Column("Status"), Column("Reason")]
    return Listing("unfinished", "Runs without a result, and why.", columns, rows)


def _name(cell: Cell) -> Entry:
    return Entry(cell.label, cell.label, cell=cell.id)


def _runs(cell: Cell) -> Entry:
    done, asked = len(cell.seeds), sum(cell.counts.values())
    return Entry(str(done) if done == asked else f"{done} of {asked}", done)


def _rate(spread: Interval | Share, *, bar: bool = True) -> Entry:
    value = formats.rate(spread)
    picture = (formats.finite(spread.low), value, formats.finite(spread.high)) if bar and value is not None else None
    return Entry(formats.percent_interval(spread), value, picture)


def _reaching(share: Share) -> Entry:
    low, high = formats.percent(share.low), formats.percent(share.high)
    spread = f" [{low}, {high}]" if low and high else ""
    return Entry(f"{share.k}/{share.n}{spread}" if share.n else "", formats.rate(share))


def _time(survival: Survival | None) -> Entry:
    if survival is None:
        return Entry("")
    median = formats.finite(survival.median)
    return Entry("fewer than half" if median is None else formats.number(median), median)


def _number(spread: Interval, digits: int = 0) -> Entry:
    return Entry(formats.number(spread.value, digits), formats.finite(spread.value))


def _further(spread: Interval, name: str) -> Entry:
    return _rate(spread, bar=False) if REPORTED[name].is_rate else _number(spread, 2)


def _counted(spread: Interval) -> Entry:
    return Entry(formats.number_interval(spread), formats.finite(spread.value))


def _whole(value: int | None) -> Entry:
    return Entry(formats.number(value), value)


def _p(p: float | None) -> Entry:
    return Entry(formats.probability(p), formats.finite(p))


def _setting(value: Setting) -> Entry:
    return Entry(formats.setting(value), value if isinstance(value, float | int) else formats.setting(value))


def _signed(value: float | None) -> str:
    return "" if formats.finite(value) is None else f"{value:+.2f}"

"""Tables about cells and their seeds: final results, times to 90 %, curves, goal slots."""

from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter, itemgetter
from typing import Any

from parking_exp.reports import formats
from parking_exp.reports.report_data import Cell, Interval, ReportData, Share, Survival
from parking_exp.reports.summaries import FURTHER, REPORTED
from parking_exp.reports.tables.model import (
    PERCENT,
    Column,
    Entry,
    Getter,
    Table,
    bounds,
    cell_columns,
    cell_name,
    column,
    number,
    percent,
    rate,
    rate_bar,
    spread,
    values,
    whole,
    words,
)


def headline(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of what each cell reached and what it cost."""
    timed = any(cell.survival for cell in cells)
    median = "; median of the env steps until 90 % were held for three evaluations" if timed else ""
    stages = dict.fromkeys(stage for cell in cells for stage in cell.counts)
    yield Table(
        "headline",
        [
            *cell_columns(),
            *values("experiment", "name"),
            Column("Seeds", _finished, {"seeds": lambda cell: len(cell.seeds)}, numeric=True),
            Column(csv={f"runs_{stage}": _count(stage) for stage in stages}),
            column("Env steps", whole, "env_steps", attrgetter("total_timesteps"), order=2),
            spread(REPORTED["success"].heading, rate_bar, "success"),
            spread(REPORTED["parked"].heading, rate, "parked"),
            spread(REPORTED["crash"].heading, rate, "crash"),
            spread(REPORTED["timeout"].heading, rate, "timeout"),
            spread(REPORTED["episode_steps"].heading, lambda mean: number(mean.value, 1), "episode_steps", order=1),
            spread("CPU (s)", lambda mean: number(mean.value), "cpu_s", order=3),
            Column(csv=bounds("area", attrgetter("area"))),
            *(spread(REPORTED[name].heading, _entry(name), name, _further(name), order=4) for name in FURTHER),
            Column(csv={"success_method": lambda cell: cell.success.method}),
            Column("Seeds ≥ 90 %", lambda cell: _reaching(cell.reaching_90), _reaching_csv(), numeric=True),
            Column(
                "Steps to hold 90 %" if timed else "",
                lambda cell: _median(cell.survival),
                _survival_csv("steps_to_90", attrgetter("survival")),
                numeric=True,
            ),
            Column(csv=_survival_csv("cpu_s_to_90", attrgetter("survival_cpu"))),
            *values("note"),
        ],
        cells,
        f"Final evaluation: means over seeds, {PERCENT}; how many seeds ended at 90 % or above, with Wilson's interval "
        f"of their share{median}.",
        title="Results",
        latex=True,
        folded=False,
        total=len(report.cells),
    )


def times(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of how long each cell took to hold 90 %, and of the area under its curve."""
    timed = [cell for cell in cells if cell.survival]
    columns = [_label(), column("Reached", lambda survival: Entry(f"{survival.k}/{survival.n}"), get=_STEPS)]
    for unit, clock in (("steps", _STEPS), ("CPU-s", _CPU)):
        horizon = next((found.horizon for found in map(clock, timed) if found and found.horizon), None)
        columns += [
            column(f"Median ({unit})", _median, get=clock),
            column(f"Mean up to {formats.number(horizon)} ({unit})", _restricted_mean, get=clock),
        ]
    yield Table(
        "times",
        [*columns, column("Area (%)", rate, get=attrgetter("area"))],
        timed,
        "Time until three evaluations in a row have 90 %, with the mean up to a time that all seeds were watched; area "
        f"under the learning curve in % of the highest possible; means {PERCENT}.",
        total=len(report.cells),
    )


def seeds(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of the finished runs. A row is (cell, seed)."""

    def of(name: str) -> Getter:
        return lambda row: getattr(row[1], name)

    def success(row: Any) -> Entry:
        return rate_bar(Interval(row[1].success, row[1].low, row[1].high))

    def reached(row: Any) -> Entry:
        steps = formats.number(row[1].steps_to_90)
        late = steps and not row[1].reached_90
        return Entry(f"> {steps}" if late else steps, formats.finite(row[1].steps_to_90))

    yield Table(
        "seeds",
        [
            *cell_columns(itemgetter(0)),
            column("Seed", lambda seed: Entry(str(seed), seed), "seed", of("seed")),
            column("Run", words, "run_id", of("run_id"), numeric=False, order=4),
            Column(csv={"run_dir": of("run_dir")}),
            Column(REPORTED["success"].heading, success, {"success": of("success")}, numeric=True),
            column(REPORTED["crash"].heading, percent, "crash", of("crash"), order=2),
            column(REPORTED["timeout"].heading, percent, "timeout", of("timeout"), order=2),
            column(REPORTED["parked"].heading, percent, "parked", of("parked"), order=1),
            column("Scenes", whole, "n_scenes", of("n_scenes"), order=2),
            Column(csv={name: of(name) for name in ("low", "high", "episode_steps")}),
            column("CPU (s)", number, "cpu_s", of("cpu_s"), order=3),
            Column("Steps to 90 %", reached, {"steps_to_90": of("steps_to_90")}, numeric=True, order=2),
            Column(csv={name: of(name) for name in ("reached_90", "cpu_s_to_90", "area")}),
            Column(csv={name: _further(name, itemgetter(1)) for name in FURTHER}),
        ],
        [(cell, seed) for cell in cells for seed in cell.seeds],
        "Finished runs: final rates over the evaluation scenes, with Wilson's 95 % interval in brackets.",
        folded=True,
        noun="finished runs",
    )


def curves(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the CSV of the learning curves. A row is (cell, step, n, success, low, high, crash)."""
    keys = ("step", "n", "success", "success_low", "success_high", "crash")
    rows = [
        (cell, *point)
        for cell in cells
        if (curve := cell.curve)
        for point in zip(curve.step, curve.n, curve.mean, curve.low, curve.high, curve.crash, strict=True)
    ]
    yield Table("curves", [*cell_columns(itemgetter(0)), *_positions(keys)], rows)


def survival(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the CSV of the times to 90 %. A row is (cell, unit, time, reached, low, high, censored)."""
    keys = ("unit", "time", "reached", "reached_low", "reached_high", "censored")
    rows: list[tuple[Any, ...]] = []
    for cell in cells:
        for found in filter(None, (cell.survival, cell.survival_cpu)):
            points = zip(found.time, found.reached, found.low, found.high, strict=True)
            rows += [(cell, found.unit, *point, False) for point in points]
            rows += [(cell, found.unit, time, None, None, None, True) for time in found.censored]
    yield Table("survival", [*cell_columns(itemgetter(0)), *_positions(keys)], rows)


def slots(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the CSV of outcomes by goal slot. A row is (cell, slot)."""
    keys = ("slot", "n", "success", "crash", "timeout")

    def of(key: str) -> Getter:
        return lambda row: getattr(row[1], key)

    rows = [(cell, slot) for cell in cells for slot in cell.slots]
    yield Table("slots", [*cell_columns(itemgetter(0)), Column(csv={key: of(key) for key in keys})], rows)


_STEPS, _CPU = attrgetter("survival"), attrgetter("survival_cpu")


def _entry(name: str) -> Callable[[Interval], Entry]:
    return rate if REPORTED[name].is_rate else lambda mean: number(mean.value, 2)


def _further(name: str, owner: Getter = lambda row: row) -> Getter:
    """Return what gets a further metric of the registry from a cell or a seed."""
    return lambda row: owner(row).further[name]


def _label(cell: Getter = lambda row: row) -> Column:
    return column("Cell", cell_name, get=cell, numeric=False)


def _positions(keys: Sequence[str]) -> list[Column]:
    return [Column(csv={key: itemgetter(position)}) for position, key in enumerate(keys, start=1)]


def _count(stage: str) -> Getter:
    return lambda cell: cell.counts.get(stage)


def _finished(cell: Cell) -> Entry:
    done, asked = len(cell.seeds), sum(cell.counts.values())
    return Entry(str(done) if done == asked else f"{done} of {asked}", done)


def _reaching(share: Share) -> Entry:
    low, high = formats.percent(share.low), formats.percent(share.high)
    spread = f" [{low}, {high}]" if low and high else ""
    return Entry(f"{share.k}/{share.n}{spread}" if share.n else "", formats.rate(share))


def _reaching_csv() -> dict[str, Getter]:
    return {
        "seeds_reaching_90": lambda cell: cell.reaching_90.k,
        "share_reaching_90": lambda cell: formats.rate(cell.reaching_90),
        "share_reaching_90_low": lambda cell: cell.reaching_90.low,
        "share_reaching_90_high": lambda cell: cell.reaching_90.high,
    }


def _median(survival: Survival | None) -> Entry:
    if survival is None:
        return Entry("")
    median = formats.finite(survival.median)
    return Entry("fewer than half" if median is None else formats.number(median), median)


def _restricted_mean(survival: Survival | None) -> Entry:
    mean = survival.restricted_mean if survival else Interval(None)
    return Entry(formats.number_interval(mean), formats.finite(mean.value))


def _survival_csv(key: str, clock: Getter) -> dict[str, Getter]:
    def of(name: str) -> Getter:
        return lambda cell: clock(cell) and getattr(clock(cell), name)

    return {
        f"{key}_median": of("median"),
        **bounds(f"{key}_restricted_mean", lambda cell: of("restricted_mean")(cell) or Interval(None)),
        f"{key}_horizon": of("horizon"),
        f"{key}_reached": of("k"),
    }

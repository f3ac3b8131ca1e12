"""The tables of a report. Each function yields what it has; columns of rows are those of `tables/*.csv`."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from parking_exp.reports import formats
from parking_exp.reports.cell_summaries import FURTHER, REPORTED
from parking_exp.reports.report_data import Cell, Interaction, ReportData
from parking_exp.reports.tables.table import (
    PERCENT,
    Column,
    Entry,
    Row,
    Table,
    cell_column,
    cell_record,
    column,
    interval_column,
    record,
    spread,
    text_column,
)
from parking_exp.statistics import Interval, Proportion

RATES = ("success", *(name for name in FURTHER if REPORTED[name].is_rate), "timeout")
VERDICTS = {"same": "indistinguishable", "unknown": "too few seeds"}


def headline(report: ReportData) -> Iterator[Table]:
    """Yield the table of what each cell reached and what it cost."""
    timed = any(cell.survival for cell in report.cells)
    median = "; median of the env steps until 90 % were held for three evaluations" if timed else ""
    yield Table(
        "headline",
        _cell_rows(report),
        [
            cell_column(),
            Column("Seeds", _finished),
            *(interval_column(REPORTED[name].heading, name, bar=name == "success") for name in _rates(report)),
            Column("Seeds ≥ 90 %", _reaching_90),
            *([_median("Steps to hold 90 %", "survival")] if timed else []),
            column(REPORTED["episode_steps"].heading, "episode_steps", partial(formats.number, digits=1)),
            column("Env steps", "total_timesteps", formats.number),
            column("CPU (s)", "cpu_s", formats.number),
            *(_mean_column(name) for name in FURTHER if not REPORTED[name].is_rate),
        ],
        f"Final evaluation: means over seeds, {PERCENT}; how many seeds ended at 90 % or above, with Wilson's interval "
        f"of their share{median}.",
        latex=True,
        folded=False,
    )


def times(report: ReportData) -> Iterator[Table]:
    """Yield the table of how long each cell took to hold 90 %, and of the area under its curve."""
    rows = [row for row in _cell_rows(report) if "survival_n" in row]
    columns = [cell_column(), Column("Reached", lambda row: Entry(f"{row['survival_k']}/{row['survival_n']}"))]
    for unit, clock in (("steps", "survival"), ("CPU-s", "survival_cpu")):
        horizon = next((row[f"{clock}_horizon"] for row in rows if row.get(f"{clock}_horizon")), None)
        mean = f"Restricted mean, up to {formats.number(horizon)} ({unit})"
        columns += [
            _median(f"Median ({unit})", clock),
            interval_column(mean, f"{clock}_restricted_mean", formats.number_interval),
        ]
    yield Table(
        "times",
        rows,
        [*columns, interval_column("AUC (%)", "area")],
        "Time until three evaluations in a row have 90 %, with the mean up to a time that all seeds were watched; area "
        f"under the learning curve in % of the highest possible; means {PERCENT}.",
        csv=False,
    )


def seeds(report: ReportData) -> Iterator[Table]:
    """Yield the table of the finished runs."""

    def reached(row: Row) -> Entry:
        steps = formats.number(row["steps_to_90"])
        return Entry(f"> {steps}" if steps and not row["reached_90"] else steps, row["steps_to_90"])

    yield Table(
        "seeds",
        [
            {
                **cell_record(cell),
                **record(seed, without=("low", "high")),
                **spread("success", Interval(seed.success, seed.low, seed.high)),
            }
            for cell in report.cells
            for seed in cell.seeds
        ],
        [
            cell_column(),
            column("Seed", "seed"),
            interval_column(REPORTED["success"].heading, "success", bar=True),
            *(column(REPORTED[name].heading, name, formats.percent) for name in _rates(report)[1:]),
            column("Episodes", "n_episodes", formats.number),
            Column("Steps to 90 %", reached),
            column("CPU (s)", "cpu_s", formats.number),
            column("Run", "run_id", numeric=False),
        ],
        "Finished runs: final rates over the evaluation episodes, with Wilson's 95 % interval in brackets.",
        folded=True,
        noun="finished runs",
    )


def curves(report: ReportData) -> Iterator[Table]:
    """Yield the CSV of the learning curves."""
    rows: list[Row] = []
    for cell in report.cells:
        if curve := cell.curve:
            success = {"success": curve.mean, "success_low": curve.low, "success_high": curve.high}
            rows += _series(cell, step=curve.step, n=curve.n, **success, failure=curve.failure)
    yield Table("curves", rows)


def survival(report: ReportData) -> Iterator[Table]:
    """Yield the CSV of the times to 90 %: steps of the estimate, and censored seeds."""
    rows: list[Row] = []
    for cell in report.cells:
        for clock in filter(None, (cell.survival, cell.survival_cpu)):
            n = len(clock.time)
            reached = {"reached": clock.reached, "reached_low": clock.low, "reached_high": clock.high}
            rows += _series(cell, unit=[clock.unit] * n, time=clock.time, **reached, censored=[False] * n)
            rows += [
                {**cell_record(cell), "unit": clock.unit, "time": time, "censored": True} for time in clock.censored
            ]
    yield Table("survival", rows)


def _series(cell: Cell, **columns: Sequence[Any]) -> list[Row]:
    return [
        {**cell_record(cell), **dict(zip(columns, row, strict=True))} for row in zip(*columns.values(), strict=True)
    ]


def pairs(report: ReportData) -> Iterator[Table]:
    """Yield the table of the pairs of cells that were compared."""
    labels = {cell.id: cell.label for cell in report.cells}
    rows = [{"a_label": labels[pair.a], "b_label": labels[pair.b], **record(pair)} for pair in report.pairs]

    def verdict(row: Row) -> str:
        better = {"a": row["a_label"], "b": row["b_label"]}.get(row["verdict"])
        return VERDICTS[row["verdict"]] if better is None else f"{better} is better"

    yield Table(
        "pairs",
        rows,
        [
            cell_column("A", "a", "a_label"),
            cell_column("B", "b", "b_label"),
            interval_column("A − B (points)", "difference", formats.signed_percent_interval),  # noqa: RUF001
            column("p (Holm)", "p_holm", formats.probability),
            interval_column("A better than B (%)", "improvement"),
            column("p, time to 90 % (Holm)", "log_rank_p_holm", formats.probability),
            text_column("In words", verdict),
        ],
        "Pairs of cells: difference of mean final success in percentage points, with 95 % interval; probability that a "
        "seed of A is better than one of B.",
        latex=True,
    )


def effects(report: ReportData) -> Iterator[Table]:
    """Yield the table of each factor's levels."""
    yield Table(
        "effects",
        [{**record(effect), **record(level)} for effect in report.effects for level in effect.levels],
        [
            column("Factor", "factor", numeric=False),
            column("Level", "level", formats.setting, numeric=False),
            interval_column("Success (%)", "effect", bar=True),
            column("Cells", "cells", formats.number),
        ],
        f"Main effects: mean final success at each level over the levels of the other factors, {PERCENT}.",
        latex=True,
    )


def interactions(report: ReportData) -> Iterator[Table]:
    """Yield one table for each two crossed factors, and one with all of them for CSV."""
    grids = ("mean", "low", "high", "residual", "n", "real_share")
    rows = []
    for position, crossed in enumerate(report.interactions, start=1):
        yield _crossed(crossed, "interactions" if position == 1 else f"interactions-{position}")
        factors = {"row_factor": crossed.row, "column_factor": crossed.column, "given": crossed.given}
        known = [name for name in grids if getattr(crossed, name)]
        rows += [
            {**factors, "row": row, "column": column, "p": crossed.p}
            | {name: getattr(crossed, name)[i][j] for name in known}
            for i, row in enumerate(crossed.rows)
            for j, column in enumerate(crossed.columns)
        ]
    yield Table("interactions", rows)


def _crossed(crossed: Interaction, name: str) -> Table:
    keys = [f"column_{j}" for j in range(len(crossed.columns))]
    rows: list[Row] = []
    for i, level in enumerate(crossed.rows):
        row: dict[str, Any] = {"level": formats.setting(level)}
        for j, key in enumerate(keys):
            row |= spread(key, Interval(crossed.mean[i][j], crossed.low[i][j], crossed.high[i][j]))
        rows.append(row)
    for level, shares in zip(crossed.rows, crossed.real_share or (), strict=False):
        title = f"{formats.level(level)}: real transitions (%)"
        rows.append({"level": title, **dict(zip(keys, shares, strict=True))})
    given = f" for {crossed.given}" if crossed.given else ""
    levels = zip(crossed.columns, keys, strict=True)
    return Table(
        name,
        rows,
        [
            column(crossed.row, "level", numeric=False),
            *(interval_column(formats.level(level), key) for level, key in levels),
        ],
        f"Mean final success (%) by {crossed.row} (rows) and {crossed.column} (columns){given}, {PERCENT}.",
        file="interactions",
        csv=False,
        latex=True,
    )


def config(report: ReportData) -> Iterator[Table]:
    """Yield the settings that differ between cells: people read the longer of cells and keys downwards."""
    difference = report.provenance.difference
    if not difference:
        return
    by_cell = [
        {**cell_record(cell), **{key: values[i] for key, values in difference.items()}}
        for i, cell in enumerate(report.cells)
    ]
    by_key = [
        {"key": key, **{cell.id: value for cell, value in zip(report.cells, values, strict=True)}}
        for key, values in difference.items()
    ]
    cell_first = [cell_column(), *(column(key, key, formats.setting, numeric=False) for key in difference)]
    key_first = [
        column("Setting", "key", numeric=False),
        *(column(cell.label, cell.id, formats.setting, numeric=False) for cell in report.cells),
    ]
    rows, columns = (by_cell, cell_first) if len(by_cell) > len(by_key) else (by_key, key_first)
    yield Table("config", by_cell)
    yield Table("config", rows, columns, "Settings that are not the same in all cells.", csv=False, latex=True)


def versions(report: ReportData) -> Iterator[Table]:
    """Yield the table of versions, commits and machines."""
    origin = report.provenance
    rows: list[Row] = [
        {"kind": "package", "name": package, "version": version, "runs": runs}
        for package, counts in origin.versions.items()
        for version, runs in counts.items()
    ]
    for kind, counts in (("commit", origin.commits), ("machine", origin.machines)):
        rows += [{"kind": kind, "name": name, "version": None, "runs": runs} for name, runs in counts.items()]
    columns = [
        text_column("What", lambda row: row["name"] if row["version"] else row["kind"]),
        text_column("Version", lambda row: row["version"] or row["name"]),
        column("Runs", "runs", formats.number),
    ]
    yield Table("versions", rows, columns, "Versions, commits and machines.")


def unfinished(report: ReportData) -> Iterator[Table]:
    """Yield the table of the runs without a result, and why."""
    rows = [record(run) for run in report.provenance.unfinished]
    columns = [
        column("Cell", "label", numeric=False),
        column("Seed", "seed"),
        column("Status", "status", numeric=False),
        column("Reason", "reason", numeric=False),
    ]
    yield Table("unfinished", rows, columns, "Runs without a result, and why.", file="failed")


def common(report: ReportData) -> Iterator[Table]:
    """Yield the table of the settings that are the same in all cells."""
    yield Table(
        "common",
        [{"key": key, "value": value} for key, value in report.provenance.common.items()],
        [column("Setting", "key", numeric=False), column("Value", "value", formats.setting, numeric=False)],
        "Settings that are the same in all cells.",
        csv=False,
        folded=True,
        noun="settings that all cells share",
    )


def _cell_rows(report: ReportData) -> list[Row]:
    stages = dict.fromkeys(stage for cell in report.cells for stage in cell.counts)
    return [
        {
            **cell_record(cell),
            "seeds": len(cell.seeds),
            **{f"runs_{stage}": cell.counts.get(stage) for stage in stages},
            **record(cell, without=("id", "label")),
        }
        for cell in report.cells
    ]


def _rates(report: ReportData) -> list[str]:
    """Return the names of the rates that some cell has."""
    return [name for name in RATES if name not in FURTHER or any(name in cell.further for cell in report.cells)]


def _mean_column(name: str) -> Column:
    return column(REPORTED[name].heading, name, partial(formats.number, digits=2))


def _finished(row: Row) -> Entry:
    done, total = row["seeds"], sum(count or 0 for key, count in row.items() if key.startswith("runs_"))
    return Entry(str(done) if done == total else f"{done} of {total}", done)


def _reaching_90(row: Row) -> Entry:
    share = Proportion(*(row[f"reaching_90_{name}"] for name in ("k", "n", "low", "high")))
    return Entry(formats.share_interval(share), share.k / share.n if share.n else None)


def _median(title: str, clock: str) -> Column:
    def entry(row: Row) -> Entry:
        median = row.get(f"{clock}_median")
        unknown = "not reached" if f"{clock}_n" in row else ""
        return Entry(unknown if median is None else formats.number(median), median)

    return Column(title, entry)

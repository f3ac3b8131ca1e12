"""Tables of what was run: settings, versions, and runs without a result."""

from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import Any

from parking_exp.reports.report_data import Cell, ReportData
from parking_exp.reports.tables.model import (
    Column,
    Entry,
    Getter,
    Table,
    cell_columns,
    column,
    setting,
    values,
    whole,
    words,
)


def config(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the tables of the settings that differ between cells: people read the longer of cells and keys downwards.

    A row is (cell, its values) or (key, its values).
    """
    difference = report.provenance.difference
    if not difference:
        return
    wanted = {cell.id for cell in cells}
    rows = [
        (cell, values) for cell, *values in zip(report.cells, *difference.values(), strict=True) if cell.id in wanted
    ]
    caption = "Settings that are not the same in all cells."
    downwards = len(rows) > len(difference)

    def at(position: int) -> Getter:
        return lambda row: row[1][position]

    by_cell = [column(key, setting, key, at(n), numeric=False) for n, key in enumerate(difference)]
    yield Table("config", [*cell_columns(itemgetter(0)), *by_cell], rows, caption if downwards else "", latex=True)
    if not downwards:
        by_key = [column(cell.label, setting, get=at(n), numeric=False) for n, (cell, _) in enumerate(rows)]
        columns = [column("Setting", words, get=itemgetter(0), numeric=False), *by_key]
        turned = [(key, [row_values[n] for _, row_values in rows]) for n, key in enumerate(difference)]
        yield Table("config", columns, turned, caption, latex=True)


def common(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of the settings that are the same in all cells. A row is (key, value)."""
    yield Table(
        "common",
        [
            column("Setting", words, get=itemgetter(0), numeric=False),
            column("Value", setting, get=itemgetter(1), numeric=False),
        ],
        list(report.provenance.common.items()),
        "Settings that are the same in all cells.",
    )


def versions(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of versions, commits and machines. A row is (kind, name, version, number of runs)."""
    found = report.provenance
    rows: list[tuple[Any, ...]] = [
        ("package", package, version, runs)
        for package, all_of_it in found.versions.items()
        for version, runs in all_of_it.items()
    ]
    rows += [("commit", name, None, runs) for name, runs in found.commits.items()]
    rows += [("machine", name, None, runs) for name, runs in found.machines.items()]

    def what(row: Any) -> Entry:
        kind, name, version, _ = row
        return words(kind if version is None else name)

    def which(row: Any) -> Entry:
        _, name, version, _ = row
        return words(name if version is None else version)

    yield Table(
        "versions",
        [
            Column(csv={"kind": itemgetter(0)}),
            Column("What", what, {"name": itemgetter(1)}),
            Column("Version", which, {"version": itemgetter(2)}),
            column("Runs", whole, "runs", itemgetter(3)),
        ],
        rows,
        "Versions, commits and machines.",
    )


def unfinished(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of the runs without a result, and why."""
    yield Table(
        "unfinished",
        [
            column("Cell", words, "label", numeric=False),
            column("Seed", lambda seed: Entry(str(seed), seed), "seed"),
            column("Status", words, "status", numeric=False),
            column("Reason", Entry, "reason", numeric=False),
            *values("run_dir"),
        ],
        report.provenance.unfinished,
        "Runs without a result, and why.",
        file="failed",
    )

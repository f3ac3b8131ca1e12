"""Tables about factors: levels of one, two of them crossed, and the hyperparameters of a search."""

from collections.abc import Iterator, Sequence
from operator import itemgetter

from parking_exp.reports import formats
from parking_exp.reports.report_data import Cell, Interaction, Interval, ReportData
from parking_exp.reports.tables.model import (
    PERCENT,
    Column,
    Entry,
    Getter,
    Table,
    bounds,
    column,
    p_value,
    percent,
    rate,
    rate_bar,
    setting,
    spread,
    whole,
    words,
)


def effects(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of each factor's levels. A row is (effect, level)."""
    yield Table(
        "effects",
        [
            column("Factor", words, "factor", lambda row: row[0].factor, numeric=False),
            column("Level", setting, "level", lambda row: row[1].level, numeric=False),
            spread("Success (%)", rate_bar, "success", lambda row: row[1].effect),
            column("Cells", whole, "cells", lambda row: row[1].cells),
            Column(csv={"n": lambda row: row[1].effect.n}),
            Column(csv=bounds("largest_difference", lambda row: row[0].largest or Interval(None))),
            Column(csv={"p_largest_difference": lambda row: row[0].p}),
        ],
        [(effect, level) for effect in report.effects for level in effect.levels],
        f"Main effects: mean final success at each level over the levels of the other factors, {PERCENT}.",
        title="Effects",
        latex=True,
    )


def interactions(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield one table for each two crossed factors, and one with all of them for CSV. There, a row is (table, i, j)."""
    for position, crossed in enumerate(report.interactions, start=1):
        yield _crossed(crossed, position)

    def at(name: str) -> Getter:
        return lambda row: getattr(row[0], name)[row[1]][row[2]]

    getters: dict[str, Getter] = {
        "row_factor": lambda row: row[0].row,
        "row": lambda row: row[0].rows[row[1]],
        "column_factor": lambda row: row[0].column,
        "column": lambda row: row[0].columns[row[2]],
        "given": lambda row: row[0].given,
        "success": at("mean"),
        "success_low": at("low"),
        "success_high": at("high"),
        "residual": at("residual"),
        "n": at("n"),
        "p_interaction": lambda row: row[0].p,
        "real_share": lambda row: row[0].real_share[row[1]][row[2]] if row[0].real_share else None,
    }
    rows = [
        (crossed, i, j)
        for crossed in report.interactions
        for i in range(len(crossed.rows))
        for j in range(len(crossed.columns))
    ]
    yield Table("interactions", [Column(csv=getters)], rows)


def _crossed(crossed: Interaction, position: int) -> Table:
    rows = []
    for i, level in enumerate(crossed.rows):
        spreads = zip(crossed.mean[i], crossed.low[i], crossed.high[i], crossed.n[i], strict=True)
        rows.append([setting(level), *(rate(Interval(mean, low, high, n)) for mean, low, high, n in spreads)])
    if crossed.real_share:
        for level, shares in zip(crossed.rows, crossed.real_share, strict=True):
            rows.append([Entry(f"{formats.level(level)}: real transitions (%)"), *map(percent, shares)])
    columns = [Column(crossed.row, itemgetter(0))]
    for j, level in enumerate(crossed.columns, start=1):
        columns.append(Column(formats.level(level), itemgetter(j), numeric=True))
    given = f" for {crossed.given}" if crossed.given else ""
    suffix = "" if position == 1 else str(position)
    return Table(
        f"interactions-{suffix}" if suffix else "interactions",
        columns,
        rows,
        f"Mean final success (%) by {crossed.row} (rows) and {crossed.column} (columns){given}, {PERCENT}.",
        title=f"Interactions {suffix}".rstrip(),
        file="interactions",
        latex=True,
    )


def importance(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of the hyperparameters of a search."""

    def bar(share: float) -> Entry:
        return Entry(formats.percent(share), share, bar=(None, share, None))

    def signed(direction: float | None) -> Entry:
        value = formats.finite(direction)
        return Entry("" if value is None else f"{value:+.2f}", value)

    yield Table(
        "importance",
        [
            column("Hyperparameter", words, "factor", numeric=False),
            column("Variance explained alone (%)", bar, "share"),
            column("p (permutations)", p_value, "p", order=1),
            column("Rank correlation", signed, "direction"),
        ],
        report.importance,
        "Hyperparameters: share of the variance of final success that each explains alone.",
        title="Importance",
        latex=True,
    )

"""The table of pairs of cells."""

from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import Any

from parking_exp.reports import formats
from parking_exp.reports.report_data import Cell, Interval, ReportData
from parking_exp.reports.tables.model import (
    Column,
    Entry,
    Table,
    cell_name,
    column,
    p_value,
    rate,
    spread,
    values,
    words,
)

VERDICTS = {"same": "can't be told apart", "unknown": "too few seeds to tell"}


def pairs(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of the pairs of cells that were compared."""
    by_id = {cell.id: cell for cell in cells}

    def verdict(pair: Any) -> Entry:
        better = {"a": pair.a, "b": pair.b}.get(pair.verdict)
        return words(f"{by_id[better].label} is better" if better else VERDICTS.get(pair.verdict, "? is better"))

    def points(difference: Interval) -> Entry:
        return Entry(formats.percent_interval(difference, signed=True), formats.rate(difference))

    yield Table(
        "pairs",
        [
            *values("a", "b"),
            Column("A", lambda pair: cell_name(by_id[pair.a]), {"a_label": lambda pair: by_id[pair.a].label}),
            Column("B", lambda pair: cell_name(by_id[pair.b]), {"b_label": lambda pair: by_id[pair.b].label}),
            spread("A − B (points)", points, "difference"),  # noqa: RUF001
            *values("p"),
            column("p (Holm)", p_value, "p_holm"),
            spread("A better than B (%)", rate, "improvement"),
            *values("log_rank_p"),
            column("p, time to 90 % (Holm)", p_value, "log_rank_p_holm"),
            Column("In words", verdict, {"verdict": attrgetter("verdict")}),
            *values("note"),
        ],
        [pair for pair in report.pairs if pair.a in by_id and pair.b in by_id],
        "Pairs of cells: difference of mean final success in percentage points, with 95 % interval; probability that a "
        "seed of A is better than one of B.",
        title="Pairs",
        latex=True,
        total=len(report.pairs),
    )

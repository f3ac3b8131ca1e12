"""The model of a table, which the page, LaTeX and CSV are written from."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from typing import Any, NamedTuple

from parking_exp.figure_style import clean
from parking_exp.reports import formats
from parking_exp.reports.report_data import CellSummary
from parking_exp.statistics import Interval, finite_or_none

PERCENT = "with 95 % intervals over seeds in brackets"

Row = Mapping[str, Any]
"""Heading in CSV -> value."""


class Column(NamedTuple):
    """A column that people read.

    Attributes:
        key: of its value in a row.
        form: writes the value, empty where nothing is known.
        of_row: returns the value, where it is made of several of a row; the page sorts by that of
            `key`.
        numeric: whether it shows numbers.
        cell: key of the id of the cell that it names.
        given: whether it is a condition, not a result: the caption has it where it is the same in
            every row.
        note: what the caption says of it, without a full stop.
        paper: whether LaTeX has it, too.
    """

    title: str
    key: str
    form: Callable[[Any], str] = formats.words
    of_row: Callable[[Row], Any] | None = None
    numeric: bool = True
    cell: str | None = None
    given: bool = False
    note: str = ""
    paper: bool = True

    def write(self, row: Row) -> str:
        """Return what it shows of a row."""
        value = row.get(self.key) if self.of_row is None else self.of_row(row)
        return self.form(value)


@dataclass(frozen=True)
class Table:
    """A table of a report."""

    name: str  # of its files; unique
    rows: Sequence[Row]  # all values
    # What people read, see `without_constants`. Without any, the table is for CSV alone.
    columns: Sequence[Column] = ()
    caption: str = ""
    latex: bool = False  # whether it is written as LaTeX, too
    folded: bool = False  # whether the page folds it away

    @property
    def readable(self) -> bool:
        """Whether there is something to read."""
        return bool(self.rows and self.columns)


def without_constants(table: Table) -> Table:
    """Return a table whose caption has the notes on its columns, and what is in every row.

    These are conditions that are the same everywhere, and what is nowhere known.
    """
    constants = ""
    columns = list(table.columns[:1])
    for column in table.columns[1:]:
        texts = {column.write(row) for row in table.rows}
        is_constant = len(table.rows) > 1 and len(texts) == 1
        if is_constant and (column.given or texts == {""}):
            text = clean(texts.pop()) or "not known"
            constants += f" {column.title} in every row: {text}."
        else:
            columns.append(column)
    notes = [column.note for column in columns if column.note]
    caption = "; ".join([table.caption.removesuffix("."), *notes])
    if caption:
        caption = f"{caption}.{constants}"
    return replace(table, columns=columns, caption=caption)


def record(item: Any, prefix: str = "", *, without: Collection[str] = ()) -> dict[str, Any]:
    """Return the fields of a dataclass as columns of a row, lists left out.

    An interval becomes NAME, NAME_low and NAME_high; another dataclass one column for each field,
    NAME_FIELD.
    """
    row: dict[str, Any] = {}
    for name, value in {**vars(item), **vars(item).get("further", {})}.items():
        if isinstance(value, Interval):
            row |= spread(prefix + name, value)
        elif is_dataclass(value):
            row |= record(value, f"{prefix}{name}_")
        elif name not in without and isinstance(value, str | int | float | None):
            row[prefix + name] = value
    return row


def spread(name: str, interval: Interval) -> dict[str, float | None]:
    """Return an interval as columns of a row: NAME, NAME_low and NAME_high."""
    return {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}


def cell_record(cell: CellSummary) -> dict[str, Any]:
    """Return the columns of a row that name its cell."""
    return {"cell": cell.id, "label": cell.label}


def text_column(
    title: str, key: str, form: Callable[[Any], str] = formats.words, *, paper: bool = True
) -> Column:
    """Return a column of one text of each row."""
    return Column(title, key, form, numeric=False, paper=paper)


def cell_column(title: str = "Cell", cell: str = "cell", label: str = "label") -> Column:
    """Return the column of the labels of cells."""
    return Column(title, label, numeric=False, cell=cell, given=True)


def interval_column(
    title: str,
    key: str,
    form: Callable[[Interval], str] = formats.percent_interval,
    *,
    paper: bool = True,
) -> Column:
    """Return a column of a number with its interval, by default a rate in per cent."""

    def find_interval(row: Row) -> Interval:
        names = (key, f"{key}_low", f"{key}_high")
        value, low, high = [finite_or_none(row.get(name)) for name in names]
        return Interval(value, low, high)

    return Column(title, key, form, find_interval, paper=paper)

"""The model of a table, which the page, Markdown, LaTeX and CSV are written from."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from typing import Any, NamedTuple

from parking_exp.reports import formats
from parking_exp.reports.report_data import Cell
from parking_exp.statistics import Interval, finite_or_none

PERCENT = "with 95 % intervals over seeds in brackets"
MOST_OPEN_ROWS = 30

Row = Mapping[str, Any]
"""Heading in CSV -> value."""


class Entry(NamedTuple):
    """What people read in one place of a table."""

    text: str  # empty where nothing is known
    value: float | str | None = None  # what it is sorted by; None comes last
    bar: tuple[float | None, float, float | None] | None = None  # (low, value, high) in 0 ... 1 to be drawn
    cell: str | None = None  # id of the cell that it names


class Column(NamedTuple):
    """A column that people read: its heading, what it shows of a row, and whether that is a number."""

    title: str
    entry: Callable[[Row], Entry]
    numeric: bool = True


@dataclass(frozen=True)
class Table:
    """A table of a report."""

    name: str  # unique among the tables that people read; for anchors
    rows: Sequence[Row]  # all values; `cell`, or `a` and `b`, are the ids of the cells that a row is about
    columns: Sequence[Column] = ()  # what people read; none: the table is for CSV alone
    caption: str = ""  # one sentence
    file: str = ""  # stem of its files; empty: `name`
    csv: bool = True  # whether it is written as CSV
    latex: bool = False  # whether it is written as LaTeX
    folded: bool | None = None  # whether the page folds it away; None: if it is long
    noun: str = "rows"  # what its rows are

    @property
    def stem(self) -> str:
        """Stem of its files."""
        return self.file or self.name

    @property
    def readable(self) -> bool:
        """Whether there is something to read."""
        return bool(self.rows and self.columns)

    @property
    def is_folded(self) -> bool:
        """Whether the page folds it away."""
        return len(self.rows) > MOST_OPEN_ROWS if self.folded is None else self.folded

    def entries(self, most: int | None = None) -> list[list[Entry]]:
        """Return what people read, row by row, or so many of the first rows."""
        return [[column.entry(row) for column in self.columns] for row in self.rows[:most]]

    def only(self, cells: Collection[str]) -> "Table":
        """Return the rows that are about these cells alone, or about none."""
        keys = ("cell", "a", "b")
        return replace(self, rows=[row for row in self.rows if all(row[key] in cells for key in keys if key in row)])


def record(item: Any, prefix: str = "", *, without: Collection[str] = ()) -> dict[str, Any]:
    """Return the fields of a dataclass as columns of a row, lists left out.

    An interval becomes NAME, NAME_low and NAME_high; another dataclass one column for each field, NAME_FIELD.
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


def cell_record(cell: Cell) -> dict[str, str]:
    """Return the columns of a row that name its cell."""
    return {"cell": cell.id, "label": cell.label}


def column(title: str, key: str, write: Callable[[Any], str] = formats.words, *, numeric: bool = True) -> Column:
    """Return a column of one value of each row, written by e.g. `formats.percent`, and sorted as a number or a text."""

    def entry(row: Row) -> Entry:
        text = write(value := row.get(key))
        return Entry(text, finite_or_none(value) if numeric else text or None)

    return Column(title, entry, numeric)


def text_column(title: str, write: Callable[[Row], str]) -> Column:
    """Return a column of a text that is made from each row."""
    return Column(title, lambda row: Entry(text := write(row), text), numeric=False)


def cell_column(title: str = "Cell", cell: str = "cell", label: str = "label") -> Column:
    """Return the column of the labels of cells."""
    return Column(title, lambda row: Entry(row[label], row[label], cell=row[cell]), numeric=False)


def interval_column(
    title: str, key: str, write: Callable[[Interval], str] = formats.percent_interval, *, bar: bool = False
) -> Column:
    """Return a column of a number with its interval, by default a rate in per cent, which the page can also draw."""

    def entry(row: Row) -> Entry:
        value, low, high = (finite_or_none(row.get(name)) for name in (key, f"{key}_low", f"{key}_high"))
        drawn = (low, value, high) if bar and value is not None else None
        return Entry(write(Interval(value, low, high)), value, drawn)

    return Column(title, entry)

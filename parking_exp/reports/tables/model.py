"""The model of a table: columns and rows, declared once for the page, Markdown, LaTeX and CSV."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, NamedTuple

from parking_exp.reports import formats
from parking_exp.reports.report_data import Cell, Interval, ReportData, Setting, Share

Getter = Callable[[Any], Any]
PERCENT = "with 95 % intervals over seeds in brackets"


class Entry(NamedTuple):
    """What people read in one place of a table.

    Attributes:
        text: what is read; empty where nothing is known.
        value: what it is sorted by; None comes last.
        bar: (low, value, high) in 0 ... 1 for a small drawing; low and high may be None.
        cell: id of the cell that it names.
    """

    text: str
    value: float | str | None = None
    bar: tuple[float | None, float, float | None] | None = None
    cell: str | None = None


@dataclass(frozen=True)
class Column:
    """What a table says of each of its rows: for people, in CSV, or both.

    Attributes:
        title: heading for people, on the page, in Markdown and LaTeX; empty: only in CSV.
        read: row -> what people read.
        csv: heading in CSV -> (row -> value), e.g. a mean and its bounds; empty: not in CSV.
        numeric: whether it holds numbers.
        order: where people read the columns in another order than that of CSV: those with a higher one come later.
    """

    title: str = ""
    read: Callable[[Any], Entry] = lambda row: Entry("")
    csv: Mapping[str, Getter] = field(default_factory=dict)
    numeric: bool = False
    order: int = 0


@dataclass(frozen=True)
class Table:
    """A table of a report: for people if it has a caption, and as CSV if its columns have keys there.

    Attributes:
        name: unique among the tables that people read; for anchors.
        columns, rows: a row may be anything that the columns know how to read.
        caption: one sentence: what it shows; empty: the table is for CSV alone.
        title: its heading in Markdown; empty: that of its section.
        file: stem of its files; empty: `name`.
        latex: whether it is also written as LaTeX.
        folded: whether the page folds it away; None: if it is long.
        noun: what its rows are.
        total: how many rows there are, if these are some of them.
    """

    name: str
    columns: Sequence[Column]
    rows: Sequence[Any]
    caption: str = ""
    title: str = ""
    file: str = ""
    latex: bool = False
    folded: bool | None = None
    noun: str = "rows"
    total: int = 0

    @property
    def stem(self) -> str:
        """Stem of its files."""
        return self.file or self.name

    @property
    def headings(self) -> list[Column]:
        """The columns that people read, in their order."""
        return sorted((column for column in self.columns if column.title), key=lambda column: column.order)

    @property
    def readable(self) -> bool:
        """Whether there is something to read."""
        return bool(self.rows and self.caption)

    def entries(self, most: int | None = None) -> list[list[Entry]]:
        """Return what people read, row by row, or so many of the first rows."""
        columns = self.headings
        return [[column.read(row) for column in columns] for row in self.rows[:most]]

    @property
    def csv(self) -> dict[str, Getter]:
        """The columns of CSV: heading -> (row -> value)."""
        return {key: get for column in self.columns for key, get in column.csv.items()}


MakeTables = Callable[[ReportData, Sequence[Cell]], Iterable[Table]]
"""What gives tables of a report; those with a row for each cell are about these cells alone."""


def column(
    title: str,
    entry: Callable[[Any], Entry],
    key: str = "",
    get: Getter | None = None,
    *,
    numeric: bool = True,
    order: int = 0,
) -> Column:
    """Return a column for people and CSV, or for people alone where it has no `key`.

    Args:
        title: heading for people.
        entry: value -> what people read, e.g. `percent`.
        key: heading in CSV.
        get: row -> value; None: its attribute `key`.
        numeric: whether it holds numbers.
        order: see `Column`.
    """
    get = get or attrgetter(key)
    return Column(title, lambda row: entry(get(row)), {key: get} if key else {}, numeric, order)


def spread(title: str, entry: Callable[[Any], Entry], key: str, get: Getter | None = None, *, order: int = 0) -> Column:
    """Return a column of intervals, which has `key`, `key_low` and `key_high` in CSV."""
    get = get or attrgetter(key)
    return Column(title, lambda row: entry(get(row)), bounds(key, get), numeric=True, order=order)


def values(*keys: str) -> list[Column]:
    """Return columns of CSV alone, one for each of these attributes of a row."""
    return [Column(csv={key: attrgetter(key)}) for key in keys]


def cell_columns(cell: Getter = lambda row: row) -> list[Column]:
    """Return what tells a row's cell: its label, and in CSV its id besides. `cell` finds it in the row."""
    label: dict[str, Getter] = {"label": lambda row: cell(row).label}
    return [
        Column(csv={"cell": lambda row: cell(row).id}),
        Column("Cell", lambda row: cell_name(cell(row)), label),
    ]


def bounds(key: str, get: Getter) -> dict[str, Getter]:
    """Return the columns of CSV for an interval: `key`, `key_low` and `key_high`."""
    return {
        key: lambda row: get(row).value,
        f"{key}_low": lambda row: get(row).low,
        f"{key}_high": lambda row: get(row).high,
    }


def cell_name(cell: Cell) -> Entry:
    """Write a cell's label."""
    return Entry(cell.label, cell.label, cell=cell.id)


def words(value: str) -> Entry:
    """Write a name or a few words."""
    return Entry(value, value)


def setting(value: Setting) -> Entry:
    """Write a config value."""
    return Entry(formats.setting(value), value if isinstance(value, float | int) else formats.setting(value))


def whole(value: int | None) -> Entry:
    """Write an integer, such as a number of cells."""
    return Entry(formats.number(value), value)


def number(value: float | None, digits: int = 0) -> Entry:
    """Write a number that may have decimals."""
    return Entry(formats.number(value, digits), formats.finite(value))


def percent(share: float | None) -> Entry:
    """Write a share in per cent."""
    return Entry(formats.percent(share), formats.finite(share))


def p_value(p: float | None) -> Entry:
    """Write a p value."""
    return Entry(formats.probability(p), formats.finite(p))


def rate(interval: Interval | Share) -> Entry:
    """Write a rate in per cent with its interval."""
    return Entry(formats.percent_interval(interval), formats.rate(interval))


def rate_bar(interval: Interval | Share) -> Entry:
    """Write a rate in per cent with its interval, which the page also draws."""
    text, value = rate(interval)[:2]
    low, high = formats.finite(interval.low), formats.finite(interval.high)
    return Entry(text, value, None if value is None else (low, formats.rate(interval) or 0.0, high))

"""Sections of reports, which tasks and users can add to: paragraphs, tables and figures.

Their functions take a report's content, a `reports.report_data.ReportData`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CaptionedFigure = tuple["Figure", str]
"""A figure and its caption."""

Row = Mapping[str, Any]
"""Heading in CSV -> value."""


def plain_text(value: Any) -> str:
    """Return a value as text, empty for None."""
    return "" if value is None else str(value)


class Column(NamedTuple):
    """A column that people read.

    Attributes:
        key: the key of its value in a row.
        to_text: writes the value; returns "" where nothing is known.
        of_row: computes the value from the row, if it needs several entries. The page sorts by
            `key` all the same.
        numeric: whether it shows numbers.
        id_key: if the column shows the label of a cell, the row's key of the cell's id.
        is_condition: whether it is a condition of the experiment, not a result. If it is the same
            in every row, the caption has it.
        note: what the caption says of it, without a full stop.
        in_latex: whether the LaTeX table has it, too.
    """

    title: str
    key: str
    to_text: Callable[[Any], str] = plain_text
    of_row: Callable[[Row], Any] | None = None
    numeric: bool = True
    id_key: str | None = None
    is_condition: bool = False
    note: str = ""
    in_latex: bool = True

    def write(self, row: Row) -> str:
        """Return what it shows of a row."""
        value = row.get(self.key) if self.of_row is None else self.of_row(row)
        return self.to_text(value)


@dataclass(frozen=True)
class Table:
    """A table of a report."""

    name: str  # names its files; unique
    rows: Sequence[Row]  # all values
    # What people read; see `move_constants_to_caption` in `reports.tables.table`. A table without
    # columns is written as CSV only.
    columns: Sequence[Column] = ()
    caption: str = ""
    latex: bool = False  # whether it is written as LaTeX, too
    folded: bool = False  # whether the page folds it away

    @property
    def readable(self) -> bool:
        """Whether there is something to read."""
        return bool(self.rows and self.columns)


@dataclass(frozen=True)
class SectionFigure:
    """A figure of a section of reports, which `draw` draws from a report's data.

    Where it gives several, their names are `NAME`, `NAME_2`, ...
    """

    name: str
    title: str
    draw: Callable[[Any], Iterable[CaptionedFigure]]


@dataclass(frozen=True)
class Section:
    """A part of a report: paragraphs, tables and figures. It is left out where it has none."""

    id: str
    title: str
    text: Callable[[Any], Iterable[str]] = lambda report: ()
    tables: Sequence[Callable[[Any], Iterable[Table]]] = ()
    figures: Sequence[SectionFigure] = ()


def cell_row(cell: Any) -> dict[str, Any]:
    """Return the columns of a row that name its cell."""
    return {"cell": cell.id, "label": cell.label}

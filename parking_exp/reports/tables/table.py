"""Columns and rows of the tables of reports."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import Any

from parking_exp.phrases import printable_line
from parking_exp.report_section import Column, Row, Table, plain_text
from parking_exp.reports import formats
from parking_exp.statistics import Interval, finite_or_none

WITH_INTERVALS = "with 95 % intervals over seeds in brackets"


def move_constants_to_caption(table: Table) -> Table:
    """Return a table whose constant columns are in its caption instead.

    These are conditions (`Column.is_condition`) that are the same in every row, and columns in
    which nothing is known. The caption also gets the notes on the other columns.
    """
    constants = ""
    columns = list(table.columns[:1])
    for column in table.columns[1:]:
        texts = {column.write(row) for row in table.rows}
        is_constant = len(table.rows) > 1 and len(texts) == 1
        if is_constant and (column.is_condition or texts == {""}):
            text = printable_line(texts.pop()) or "not known"
            constants += f" {column.title} in every row: {text}."
        else:
            columns.append(column)
    notes = [column.note for column in columns if column.note]
    caption = "; ".join([table.caption.removesuffix("."), *notes])
    if caption:
        caption = f"{caption}.{constants}"
    return replace(table, columns=columns, caption=caption)


def row_of(item: Any, without: Collection[str] = ()) -> dict[str, Any]:
    """Return the fields of a dataclass, or entries of a mapping, as columns of a row.

    An interval becomes NAME, NAME_low and NAME_high. Everything else that is not a single value is
    left out.
    """
    row: dict[str, Any] = {}
    entries = item if isinstance(item, Mapping) else vars(item)
    for name, value in entries.items():
        if name in without:
            continue
        if isinstance(value, Interval):
            row |= spread(name, value)
        elif isinstance(value, str | int | float | None):
            row[name] = value
    return row


def spread(name: str, interval: Interval) -> dict[str, float | None]:
    """Return an interval as columns of a row: NAME, NAME_low and NAME_high."""
    return {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}


def text_column(
    title: str, key: str, to_text: Callable[[Any], str] = plain_text, *, in_latex: bool = True
) -> Column:
    """Return a column of one text of each row."""
    return Column(title, key, to_text, numeric=False, in_latex=in_latex)


def cell_column(title: str = "Cell", id_key: str = "cell", label: str = "label") -> Column:
    """Return the column of the labels of cells."""
    return Column(title, label, numeric=False, id_key=id_key, is_condition=True)


def interval_column(
    title: str,
    key: str,
    to_text: Callable[[Interval], str] = formats.percent_interval,
    *,
    in_latex: bool = True,
) -> Column:
    """Return a column of a number with its interval, by default a rate in per cent."""

    def find_interval(row: Row) -> Interval:
        names = (key, f"{key}_low", f"{key}_high")
        value, low, high = [finite_or_none(row.get(name)) for name in names]
        return Interval(value, low, high)

    return Column(title, key, to_text, find_interval, in_latex=in_latex)

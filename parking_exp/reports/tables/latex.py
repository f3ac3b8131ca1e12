"""Write tables of a report as LaTeX, no wider than the text of an `article`.

A document needs `\\usepackage{array,booktabs,longtable}`.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from parking_exp.phrases import printable_line
from parking_exp.report_section import Column, Row, Table
from parking_exp.reports.tables.table import move_constants_to_caption

MAX_COLUMNS = 5  # beside the first; a wider table is split
MAX_ROWS = 8  # a table with more may break across pages
MAX_LETTERS = 24  # a longer text makes its column no wider
BREAK = "\u200b"
# A line of a long name may end after it.
BREAKABLE = re.compile(r"([_=/,:]|[.-](?=\D)|[^\W_]{8})(?=\S)")
SPECIAL = {
    **{character: f"\\{character}" for character in "%#_&${}"},
    "\\": r"\textbackslash{}",
    "^": r"\^{}",
    "~": r"\~{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "\u2212": "$-$",
    "\u2265": r"$\geq$",
    BREAK: r"\allowbreak{}",
}
ESCAPED = str.maketrans(SPECIAL)


def to_latex(table: Table) -> str:
    """Return a table as LaTeX; a wide table is split into several."""
    columns = [column for column in table.columns if column.in_latex]
    readable = move_constants_to_caption(replace(table, columns=columns))
    first, *others = readable.columns
    caption = readable.caption.translate(ESCAPED)
    parts = ["% \\usepackage{array,booktabs,longtable}\n"]
    for begin in range(0, max(1, len(others)), MAX_COLUMNS):
        part = [first, *others[begin : begin + MAX_COLUMNS]]
        label = f"tab:{table.name}"
        if begin > 0:
            caption = "Continued."
            label += f"_{len(parts)}"
        parts.append(_write_part(table.rows, part, caption, label))
    return "".join(parts)


def _write_part(rows: Sequence[Row], columns: Sequence[Column], caption: str, label: str) -> str:
    # The texts of each column, the heading first.
    texts = []
    for column in columns:
        heading = _breakable(printable_line(column.title))
        cells = [printable_line(column.write(row)) or "--" for row in rows]
        if not column.numeric:
            cells = [_breakable(cell) for cell in cells]
        texts.append([heading, *cells])

    widths = [_letters(column_texts) for column_texts in texts]
    layout = ""
    for column, width in zip(columns, widths, strict=True):
        side = "left" if column.numeric else "right"
        share = 0.99 * width / sum(widths)
        layout += (
            rf">{{\footnotesize\ragged{side}\arraybackslash}}"
            rf"p{{\dimexpr{share:.3f}\linewidth-2\tabcolsep\relax}}"
        )

    frame = pd.DataFrame(texts).map(lambda text: text.translate(ESCAPED)).T
    headings = list(frame.iloc[0])
    return (
        frame[1:]
        .set_axis(headings, axis="columns")
        .to_latex(
            index=False,
            column_format=layout,
            longtable=len(rows) > MAX_ROWS,
            caption=caption,
            label=label,
        )
    )


def _letters(texts: Sequence[str]) -> float:
    """Return how wide a column should be: at least as its longest word."""
    words = re.split(rf"[ {BREAK}]", " ".join(texts))
    longest_word = max(map(len, words))
    longest_text = max(map(len, texts))
    return max(longest_word + 2, 0.65 * min(MAX_LETTERS, longest_text))


def _breakable(text: str) -> str:
    return BREAKABLE.sub(rf"\1{BREAK}", text)

"""Tables of a report as LaTeX: no wider than the text of an `article`; long ones go over several
pages.

A document needs `\\usepackage{array,booktabs,longtable}`. Widths are in em of the font `\\small`,
of which a line of an article has 35.6 to 37.3.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from parking_exp.figure_style import clean
from parking_exp.reports.tables.table import Column, Table, without_constants

LINE_EM = 35.0
GAP_EM = 0.8  # between two columns
SLACK_EM = 0.3  # of each column: widths of texts are estimated
MAX_LINES = 24  # of a table on one page, estimated: words leave lines half empty
BREAK, NO_BREAK = "\u200b", "\u00a0"
BREAKABLE = re.compile(
    r"([_=/,:]|[.-](?=\D)|[^\W_]{12})(?=\S)"
)  # after it, a line of a long name may end
INSIDE_INTERVAL = re.compile(r", (?=[^\[\]]*\])")
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
    NO_BREAK: "~",
}
ESCAPED = str.maketrans(SPECIAL)
NARROW, WIDE = frozenset(" .,:;'!|()[]-ijlftrI"), frozenset("mw%=+<>\u2212\u2265")


@dataclass(frozen=True)
class LatexColumn:
    """A column with its texts, the heading first."""

    column: Column
    texts: Sequence[str]

    @property
    def narrowest(self) -> float:
        """Width at which no piece of a text sticks out."""
        pieces = [piece for text in self.texts for piece in re.split(rf"[ {BREAK}]", text)]
        return max(map(_width, pieces)) + SLACK_EM

    @property
    def widest(self) -> float:
        """Width at which every text is on one line."""
        return max(map(_width, self.texts)) + SLACK_EM


def to_latex(table: Table) -> str:
    """Return a table with the columns for a paper, in several parts if these do not fit beside each
    other.
    """
    paper = replace(table, columns=[column for column in table.columns if column.paper])
    kept = without_constants(paper).columns
    constant = [column for column in paper.columns if column not in kept]
    parts = _split([_to_latex_column(column, table) for column in kept])
    lines = [r"% \usepackage{array,booktabs,longtable}"]
    for number, part in enumerate(parts, start=1):
        columns = [latex.column for latex in part]
        if number == 1:
            columns += constant
        caption = without_constants(replace(table, columns=columns)).caption.translate(ESCAPED)
        suffix = f"_{number}" if number > 1 else ""
        lines += _write_part(part, rf"\caption{{{caption}}}\label{{tab:{table.name}{suffix}}}")
    return "\n".join(lines) + "\n"


def _to_latex_column(column: Column, table: Table) -> LatexColumn:
    texts = [clean(column.write(row)) or "--" for row in table.rows]
    if column.numeric:
        texts = [INSIDE_INTERVAL.sub(f",{NO_BREAK}", text) for text in texts]
    else:
        texts = [_breakable(text) for text in texts]
    return LatexColumn(column, [_breakable(clean(column.title)), *texts])


def _breakable(text: str) -> str:
    return BREAKABLE.sub(rf"\1{BREAK}", text)


def _width(text: str) -> float:
    """Return about how wide a text is in Computer Modern, rather too much than too little."""
    width = 0.0
    for character in text:
        if character in NARROW:
            width += 0.4
        elif character.isdigit():
            width += 0.52
        elif character in WIDE or character.isupper():
            width += 0.85
        elif character != BREAK:
            width += 0.57
    return width


def _split(columns: Sequence[LatexColumn]) -> list[list[LatexColumn]]:
    """Return parts whose columns fit beside each other, each with the first column."""
    first, *others = columns
    parts = [[first]]
    for column in others:
        enough = (
            sum(other.narrowest for other in parts[-1]) + column.narrowest + GAP_EM * len(parts[-1])
        )
        if enough > LINE_EM and len(parts[-1]) > 1:
            parts.append([first])
        parts[-1].append(column)
    return parts


def _allot(columns: Sequence[LatexColumn]) -> list[float]:
    """Return the width of each column: one line for every text or, where that is too wide, more for
    words only.
    """
    line = LINE_EM - GAP_EM * (len(columns) - 1)
    widest = [column.widest for column in columns]
    if sum(widest) <= line:
        return widest
    spare = line - sum(column.narrowest for column in columns)
    wanted = sum(
        column.widest - column.narrowest for column in columns if not column.column.numeric
    )
    share = min(1.0, max(0.0, spare) / wanted) if wanted else 0.0
    widths = []
    for column in columns:
        more = 0.0 if column.column.numeric else share * (column.widest - column.narrowest)
        widths.append(column.narrowest + more)
    return widths


def _write_part(columns: Sequence[LatexColumn], heading: str) -> list[str]:
    """Return the lines of a table that is as wide as one line of text at most."""
    widths = _allot(columns)
    layout = ""
    for column, width in zip(columns, widths, strict=True):
        side = "left" if column.column.numeric else "right"
        layout += rf">{{\ragged{side}\arraybackslash}}p{{{width:.2f}em}}"
    head, *rows = zip(*(column.texts for column in columns), strict=True)
    heads = [r"\toprule", _write_row(head), r"\midrule"]
    body = [_write_row(row) for row in rows]
    n_lines = 0
    for row in rows:
        n_lines += max(
            math.ceil(_width(text) / width) for text, width in zip(row, widths, strict=True)
        )
    gap = rf"\setlength{{\tabcolsep}}{{{GAP_EM / 2}em}}"
    if n_lines <= MAX_LINES:
        begin = [
            r"\begin{table}",
            r"\centering",
            r"\small",
            gap,
            heading,
            rf"\begin{{tabular}}{{@{{}}{layout}@{{}}}}",
        ]
        return [*begin, *heads, *body, r"\bottomrule", r"\end{tabular}", r"\end{table}"]
    begin = [
        r"\begingroup",
        r"\centering",
        r"\small",
        gap,
        rf"\begin{{longtable}}{{@{{}}{layout}@{{}}}}",
    ]
    heads = [
        rf"{heading}\\",
        *heads,
        r"\endfirsthead",
        *heads,
        r"\endhead",
        r"\bottomrule",
        r"\endfoot",
    ]
    return [*begin, *heads, *body, r"\end{longtable}", r"\endgroup"]


def _write_row(texts: Sequence[str]) -> str:
    return " & ".join(text.translate(ESCAPED) for text in texts) + r" \\"

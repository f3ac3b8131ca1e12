"""Any table as Markdown, LaTeX and CSV. The page's writer is `templates/macros.html.j2`."""

from collections.abc import Collection

import numpy as np
import pandas as pd

from parking_exp.reports import formats
from parking_exp.reports.tables.table import Table

MARKDOWN_ROWS = 100
"""A longer table is cut: `tables/*.csv` hold everything."""
LATEX_ROWS = 60
"""A longer table is of no use on paper."""


def markdown(table: Table, shown: Collection[str]) -> str:
    """Return a table for GitHub's Markdown under its caption: the cells `shown`, and the first rows of a long one."""
    escape, rows = formats.markdown, table.only(shown).entries(MARKDOWN_ROWS)
    lines = [
        [escape(column.title) for column in table.columns],
        ["---:" if column.numeric else ":---" for column in table.columns],
        *([escape(entry.text) or "–" for entry in row] for row in rows),  # noqa: RUF001
    ]
    cut = f" {len(rows)} of {len(table.rows)} rows; `tables/` holds them all." if len(rows) < len(table.rows) else ""
    return "\n".join([escape(table.caption) + cut, "", *(f"| {' | '.join(line)} |" for line in lines)])


def latex(table: Table) -> str:
    """Return a table for LaTeX with booktabs; `--` where nothing is known."""
    rows = table.entries(LATEX_ROWS)
    cut = f" The first {LATEX_ROWS} of {len(table.rows)} rows." if len(rows) < len(table.rows) else ""
    frame = pd.DataFrame(
        [[formats.latex(entry.text) or "--" for entry in row] for row in rows],
        columns=[formats.latex(column.title) for column in table.columns],
    )
    return str(
        frame.style.hide(axis="index").to_latex(
            hrules=True,
            position="htbp",
            position_float="centering",
            caption=formats.latex(table.caption + cut),
            label=f"tab:{table.name}",
            column_format="".join("r" if column.numeric else "l" for column in table.columns),
        )
    )


def csv(table: Table) -> str:
    """Return a table as CSV: shares in 0 ... 1, nothing where nothing is known.

    A text that a spreadsheet would run as a formula gets an apostrophe before it; `report.json` has it as it is.
    """
    frame = pd.DataFrame(list(table.rows)).rename(columns=formats.csv).replace([np.inf, -np.inf], np.nan)
    texts = frame.select_dtypes(exclude="number").columns
    frame[texts] = frame[texts].map(formats.csv)
    return str(frame.to_csv(index=False, lineterminator="\n", float_format="%.10g"))

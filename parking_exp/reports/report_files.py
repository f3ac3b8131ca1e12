"""Write a report's files; an earlier report of the same name is replaced."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.reports.render.report_pages import markdown, one_line, page
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SectionContent, draw, section_contents
from parking_exp.reports.tables.table import Table
from parking_exp.runs.atomic_files import write_atomically

LATEX_ROWS = 60  # a longer table does not fit on a page
LATEX = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "−": "$-$",  # noqa: RUF001
    "≥": r"$\geq$",
    "×": r"$\times$",  # noqa: RUF001
}


def write_report(report: ReportData, folder: Path, formats: Sequence[str]) -> None:
    """Write all files of a report; `figures` and `tables` are replaced as a whole, and the page is the last."""
    numbers = json.dumps(report.plain(), ensure_ascii=False, allow_nan=False, indent=1)
    with TemporaryDirectory(prefix=".new-", dir=folder) as new:
        figures, tables = Path(new) / "figures", Path(new) / "tables"
        contents = section_contents(report, draw(report, figures, formats))
        write_tables(contents, report.shown, tables)
        html = page(report, contents)
        text = markdown(report, contents, next((ending for ending in ("png", "svg") if ending in formats), None))
        for part in (figures, tables):
            if (folder / part.name).exists():
                shutil.rmtree(folder / part.name)
            part.rename(folder / part.name)
    for name, written in (("report.json", numbers), ("report.md", text), ("index.html", html)):
        write_atomically(folder / name, written)


def write_tables(contents: Sequence[SectionContent], shown: Sequence[str], folder: Path) -> None:
    """Write every table as CSV, and those for a paper as LaTeX with booktabs: of the cells in the figures."""
    folder.mkdir(parents=True, exist_ok=True)
    tables = [table for content in contents for table in content.tables if table.rows]
    texts = {f"{table.stem}.csv": csv(table) for table in tables if table.csv}
    for table in tables:
        if table.latex and table.readable:
            name = f"{table.stem}.tex"
            texts[name] = "\n".join(filter(None, (texts.get(name), latex(table.only(shown)))))
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def csv(table: Table) -> str:
    """Return a table as CSV: rates in 0 ... 1, nothing where nothing is known."""
    frame = pd.DataFrame(list(table.rows)).rename(columns=csv_text).replace([np.inf, -np.inf], np.nan)
    texts = frame.select_dtypes(exclude="number").columns
    frame[texts] = frame[texts].map(csv_text)
    return str(frame.to_csv(index=False, lineterminator="\n", float_format="%.10g"))


def csv_text(value: Any) -> Any:
    """Keep spreadsheets from running a text as a formula: an apostrophe before `=`, `+`, `-`, `@`, tab and return."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value


def latex(table: Table) -> str:
    """Return a table for LaTeX with booktabs; `--` where nothing is known."""
    rows = table.entries(LATEX_ROWS)
    cut = f" The first {LATEX_ROWS} of {len(table.rows)} rows." if len(rows) < len(table.rows) else ""
    frame = pd.DataFrame(
        [[latex_text(entry.text) or "--" for entry in row] for row in rows],
        columns=[latex_text(column.title) for column in table.columns],
    )
    return str(
        frame.style.hide(axis="index").to_latex(
            hrules=True,
            position="htbp",
            position_float="centering",
            caption=latex_text(table.caption + cut),
            label=f"tab:{table.name}",
            column_format="".join("r" if column.numeric else "l" for column in table.columns),
        )
    )


def latex_text(text: str) -> str:
    """Escape a text for LaTeX; `[` at its start would otherwise be an argument of the line break before it."""
    escaped = "".join(LATEX.get(character, character) for character in one_line(text))
    return "{}" + escaped if escaped.startswith(("[", "*")) else escaped

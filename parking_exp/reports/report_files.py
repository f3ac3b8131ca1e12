"""Write a report's files; an earlier report of the same name is replaced."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.report_section import Section, Table
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.report_page import render_page
from parking_exp.reports.sections import (
    SectionContent,
    draw_figures,
    section_contents,
    sections_of,
)
from parking_exp.reports.tables.latex import to_latex
from parking_exp.runs.atomic_files import write_atomically

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def write_report(
    report: ReportData, folder: Path, formats: Sequence[str], user_sections: Sequence[Section] = ()
) -> None:
    """Write all files of a report, the page last; figures and tables are replaced as a whole."""
    sections = [*sections_of(report), *user_sections]
    numbers = json.dumps(report.plain(), ensure_ascii=False, allow_nan=False, indent=1)
    with TemporaryDirectory(prefix=".new-", dir=folder) as temporary:
        new = Path(temporary)
        figures = draw_figures(report, new / "figures", formats, sections)
        contents = section_contents(report, figures, sections)
        write_tables(contents, new / "tables")
        html = render_page(report, contents)
        for name in ("figures", "tables"):
            if (folder / name).exists():
                shutil.rmtree(folder / name)
            (new / name).rename(folder / name)
    write_atomically(folder / "report.json", numbers)
    write_atomically(folder / "index.html", html)


def write_tables(contents: Sequence[SectionContent], folder: Path) -> None:
    """Write every table as CSV, and those for a paper as LaTeX."""
    folder.mkdir(parents=True, exist_ok=True)
    for content in contents:
        for table in content.tables:
            if table.rows:
                (folder / f"{table.name}.csv").write_text(to_csv(table), encoding="utf-8")
            if table.rows and table.latex:
                (folder / f"{table.name}.tex").write_text(to_latex(table), encoding="utf-8")


def to_csv(table: Table) -> str:
    """Return a table as CSV: rates in 0 ... 1, nothing where nothing is known."""
    frame = pd.DataFrame(list(table.rows)).rename(columns=escape_formula)
    frame = frame.replace([np.inf, -np.inf], np.nan).map(escape_formula)
    return str(frame.to_csv(index=False, lineterminator="\n", float_format="%.10g"))


def escape_formula(value: Any) -> Any:
    """Put an apostrophe before a text that a spreadsheet would run as a formula."""
    if isinstance(value, str) and value.startswith(FORMULA_STARTS):
        return f"'{value}"
    return value

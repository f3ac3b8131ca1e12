"""Write a report's files; an earlier report of the same name is replaced."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from parking_exp.reports.figures.figure_files import draw
from parking_exp.reports.figures.figure_style import cell_style
from parking_exp.reports.render.html_page import page
from parking_exp.reports.render.markdown_report import markdown
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SectionContent, section_contents
from parking_exp.reports.tables.table_writers import csv, latex
from parking_exp.runs.atomic_files import write_atomically


def write_report(report: ReportData, folder: Path, formats: Sequence[str]) -> None:
    """Write all files of a report; `figures` and `tables` are replaced as a whole, and the page is the last."""
    numbers = json.dumps(report.plain(), ensure_ascii=False, allow_nan=False, indent=1)
    with TemporaryDirectory(prefix=".new-", dir=folder) as new:
        figures, tables = Path(new) / "figures", Path(new) / "tables"
        contents = section_contents(report, draw(report, figures, formats))
        write_tables(contents, report.shown, tables)
        html = page(report, contents, {cell: cell_style(cell) for cell in report.shown})
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

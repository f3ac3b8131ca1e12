"""Write a report's files, each atomically, and delete those that an earlier report of this name has left."""

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from parking_exp.reports.figures.export import draw
from parking_exp.reports.figures.style import cell_style
from parking_exp.reports.render.markdown import markdown
from parking_exp.reports.render.page import page
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SECTIONS, Section, report_tables
from parking_exp.reports.tables.writers import csv, latex
from parking_exp.runs.atomic_files import write_atomically

PARTS = ("figures", "tables")
MADE = ".made-"  # what a report has put into a folder: only that is its to delete


def write(report: ReportData, folder: Path, formats: Sequence[str]) -> None:
    """Write all files of a report; the page is the last.

    Args:
        report: what it says.
        folder: made if it is not there; other files in it stay as they are.
        formats: of the figures.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = json.dumps(report.plain(), ensure_ascii=False, allow_nan=False, indent=1)
    with TemporaryDirectory(prefix=".new-", dir=folder) as new:
        figures = _made(Path(new) / "figures")
        pictures = draw(report, figures, formats)
        write_tables(report, _made(Path(new) / "tables"))
        html = page(report, pictures, {name: cell_style(name) for name in report.shown})
        linked = next((one for one in ("png", "svg") if one in formats), None)
        text = markdown(report, pictures if linked else (), linked or "")
        for part in PARTS:
            _replace(Path(new) / part, _made(folder / part))
    for name, written in (("report.json", numbers), ("report.md", text), ("index.html", html)):
        write_atomically(folder / name, written)


def write_tables(report: ReportData, folder: Path, sections: Sequence[Section] = SECTIONS) -> list[Path]:
    """Write every table as CSV and those fit for a paper as LaTeX (`\\usepackage{booktabs}`); return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {f"{t.stem}.csv": csv(t) for t in report_tables(report, report.cells, sections) if t.rows and t.csv}
    for table in report_tables(report, report.shown_cells, sections):
        if table.latex and table.readable:
            name = f"{table.stem}.tex"
            texts[name] = "\n".join(filter(None, (texts.get(name), latex(table))))
    for name, text in texts.items():
        write_atomically(folder / name, text, durable=False)
    return [folder / name for name in texts]


def _replace(new: Path, folder: Path) -> None:
    """Move all files of a folder into another one, and delete there what an earlier report has left."""
    names, before = {path.name for path in new.iterdir()}, folder.with_name(f"{MADE}{folder.name}")
    listed = before.read_text(encoding="utf-8").splitlines() if before.exists() else []
    stale = {path.name for path in folder.iterdir()} & set(listed) - names
    write_atomically(before, "\n".join(sorted(names | stale)))
    for path in new.iterdir():
        path.replace(folder / path.name)
    for name in stale:
        (folder / name).unlink(missing_ok=True)
    write_atomically(before, "\n".join(sorted(names)))


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder

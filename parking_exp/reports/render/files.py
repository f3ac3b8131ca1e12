"""A report as files. Each is whole or not there; what an earlier report of this name left and this one has not goes."""

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from parking_exp.reports.data import Content
from parking_exp.reports.figures.draw import draw
from parking_exp.reports.figures.pdf import Printer
from parking_exp.reports.figures.style import cell_style
from parking_exp.reports.render.markdown import markdown
from parking_exp.reports.render.page import page
from parking_exp.reports.render.tables import write_tables
from parking_exp.runs.atomic import write_atomically

PARTS = ("figures", "tables")
MADE = ".made-"  # what a report has put into a folder: only that is its to delete


def write(content: Content, folder: Path, formats: Sequence[str], printer: Printer | None = None) -> None:
    """Write all files of a report; the page is the last.

    Args:
        content: what it says.
        folder: made if it is not there; other files in it stay as they are.
        formats: of the figures.
        printer: draws PDFs meanwhile; None: they are drawn here.
    """
    folder.mkdir(parents=True, exist_ok=True)
    numbers = json.dumps(content.plain(), ensure_ascii=False, allow_nan=False, indent=1)
    with TemporaryDirectory(prefix=".new-", dir=folder) as new:
        figures = _made(Path(new) / "figures")
        if printer is not None:
            printer.draw(content, figures)
        pictures = draw(content, figures, [one for one in formats if printer is None or one != "pdf"])
        write_tables(content, _made(Path(new) / "tables"))
        html = page(content, pictures, {name: cell_style(name) for name in content.shown})
        linked = next((one for one in ("png", "svg") if one in formats), None)
        text = markdown(content, pictures if linked else (), linked or "")
        if printer is not None:
            printer.wait()
        for part in PARTS:
            _replace(Path(new) / part, _made(folder / part))
    for name, written in (("report.json", numbers), ("report.md", text), ("index.html", html)):
        write_atomically(folder / name, written)


def _replace(new: Path, folder: Path) -> None:
    """Move all files of a folder into another one, and delete there what an earlier report has left."""
    names, before = {path.name for path in new.iterdir()}, folder.with_name(f"{MADE}{folder.name}")
    stale = set(before.read_text(encoding="utf-8").splitlines()) - names if before.exists() else set()
    write_atomically(before, "\n".join(sorted(names | stale)))
    for path in new.iterdir():
        path.replace(folder / path.name)
    for name in stale:
        (folder / name).unlink(missing_ok=True)
    write_atomically(before, "\n".join(sorted(names)))


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder

"""The report as one HTML file: no network, no library, readable without JavaScript."""

import base64
import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from parking_exp.reports import formats
from parking_exp.reports.render.markdown_report import badges
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SectionContent
from parking_exp.reports.tables.table import Table

if TYPE_CHECKING:
    from parking_exp.reports.figures.figure_style import CellStyle

TEMPLATES = Path(__file__).parent / "templates"
MAX_ROWS = 3000
"""A longer table is left to `tables/*.csv`; the page has its part about the cells in the figures."""

MARKERS = {
    "o": "M5 .8a4.2 4.2 0 1 1 0 8.4a4.2 4.2 0 1 1 0-8.4z",
    "s": "M1.2 1.2h7.6v7.6h-7.6z",
    "^": "M5 .6l4.6 8.4h-9.2z",
    "v": "M5 9.4l4.6-8.4h-9.2z",
    "D": "M5 0l5 5l-5 5l-5-5z",
    "P": "M3.4 .4h3.2v3h3v3.2h-3v3h-3.2v-3h-3v-3.2h3z",
    "X": "M2.8 .5l2.2 2.2l2.2-2.2l2.3 2.3l-2.2 2.2l2.2 2.2l-2.3 2.3l-2.2-2.2l-2.2 2.2l-2.3-2.3l2.2-2.2l-2.2-2.2z",
}


def page(
    report: ReportData, contents: Sequence[SectionContent], styles: "Mapping[str, CellStyle] | None" = None
) -> str:
    """Return `index.html`. Everything is escaped; pictures are embedded as images, in which nothing is executed.

    `styles` of the cells in the figures, by id, are drawn beside their names.
    """
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": formats.number, "base64": lambda data: base64.b64encode(data).decode()}
    style, script = (TEMPLATES.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    stages = sum((Counter(cell.counts) for cell in report.cells), Counter())
    return environment.get_template("index.html.j2").render(
        report=report,
        style=Markup(style),
        script=Markup(script),
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        sections=[part for part in contents if part.text or part.pictures or part.readable_tables],
        shortened=lambda table: _shortened(table, report.shown),
        swatches={cell: _swatch(style) for cell, style in (styles or {}).items()},
        badges=badges(report),
        stages=stages,
    )


def _swatch(style: "CellStyle") -> Markup:
    svg = Markup('<svg viewBox="0 0 10 10"><path fill="{}" d="{}"/></svg>')
    return svg.format(style.colour, MARKERS.get(style.marker, MARKERS["o"]))


def _shortened(table: Table, shown: Sequence[str]) -> tuple[Table, str]:
    """Return a table, of the cells in the figures alone if it would be too long, and a note that says so."""
    if len(table.rows) <= MAX_ROWS:
        return table, ""
    note = f" Only the cells that the figures show: the whole table is in tables/{table.stem}.csv."
    return table.only(shown), note

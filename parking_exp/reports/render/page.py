"""The report as one HTML file: no network, no library, readable without JavaScript."""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from parking_exp.reports import formats
from parking_exp.reports.methods import REFERENCES, methods
from parking_exp.reports.report_data import Cell, ReportData
from parking_exp.reports.sections import SECTIONS, Section, provenance_tables, section_tables
from parking_exp.reports.tables.model import Table

if TYPE_CHECKING:
    from parking_exp.reports.figures.figure_files import Picture
    from parking_exp.reports.figures.figure_style import CellStyle

TEMPLATES = Path(__file__).parent / "templates"
MAX_ROWS = 3000
"""A longer table is left to `tables/*.csv`, where its part about the cells in the figures is longer too."""


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
    report: ReportData,
    pictures: Sequence["Picture"] = (),
    styles: "Mapping[str, CellStyle] | None" = None,
    sections: Sequence[Section] = SECTIONS,
) -> str:
    """Return `index.html`.

    Args:
        report: what to say; everything in it is escaped.
        pictures: figures; their SVG goes in as images, in which nothing is executed.
        styles: of the cells in the figures, by id; drawn beside their names.
        sections: its parts.
    """
    style, script = (TEMPLATES.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    return (
        _environment()
        .get_template("index.html.j2")
        .render(
            report=report,
            style=Markup(style),
            script=Markup(script),
            script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
            sections=[part for section in sections if (part := _section(section, report, pictures))],
            provenance=provenance_tables(report, report.cells),
            swatches={cell: _swatch(style) for cell, style in (styles or {}).items()},
            badges=_badges(report),
            methods=list(methods(report)),
            references=REFERENCES,
            stages=_stages(report.cells),
        )
    )


def _swatch(style: "CellStyle") -> Markup:
    svg = Markup('<svg viewBox="0 0 10 10"><path fill="{}" d="{}"/></svg>')
    return svg.format(style.colour, MARKERS.get(style.marker, MARKERS["o"]))


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = formats.number
    return environment


def _section(section: Section, report: ReportData, pictures: Sequence["Picture"]) -> dict[str, Any] | None:
    """Return what the template needs of a section; None where it has nothing to say."""
    drawn = [
        {"name": p.name, "title": p.title, "caption": p.caption, "svg": base64.b64encode(p.svg).decode()}
        for p in pictures
        if p.section == section.id
    ]
    found = [_cut(table, section, report) for table in section_tables(section, report, report.cells) if table.readable]
    text = section.text(report)
    if not (drawn or found or text):
        return None
    return {"section": section, "text": text, "pictures": drawn, "tables": found}


def _cut(table: Table, section: Section, report: ReportData) -> tuple[Table, str]:
    """Return a table, of the cells in the figures alone if it would be too long, and a note that says so."""
    if len(table.rows) <= MAX_ROWS:
        return table, ""
    shorter = section_tables(section, report, report.shown_cells)
    table = next(one for one in shorter if one.name == table.name and one.caption)
    return table, f" Only the cells that the figures show: the whole table is in tables/{table.stem}.csv."


def _badges(report: ReportData) -> list[tuple[str, str]]:
    badges = []
    if report.quick:
        badges.append(("preliminary", "made while runs may still have been under way"))
    if report.exploratory:
        badges.append(("exploratory", "fewer than 10 seeds in some cell"))
    if n := len(report.warnings):
        badges.append((f"{n} warning{'s' if n > 1 else ''}", "about what makes numbers hard to compare"))
    return badges


def _stages(cells: Sequence[Cell]) -> dict[str, int]:
    """Return how many runs are at each stage, over all cells."""
    stages: dict[str, int] = {}
    for cell in cells:
        for stage, count in cell.counts.items():
            stages[stage] = stages.get(stage, 0) + count
    return {stage: count for stage, count in stages.items() if count}

"""The report as one HTML file: no network, no library, readable without JavaScript."""

import base64
import hashlib
from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from parking_exp.figure_style import cell_style
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SectionContent

TEMPLATES = Path(__file__).parent / "templates"
MARKERS = {"o": "●", "s": "■", "^": "▲", "D": "◆", "v": "▼", "P": "✚", "X": "✖"}


def render_page(report: ReportData, contents: Sequence[SectionContent]) -> str:
    """Return `index.html`.

    Everything is escaped. Figures are embedded as images, in which nothing is executed.
    """
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": formats.number, "base64": _to_base64}
    style = (TEMPLATES / "page.css").read_text(encoding="utf-8")
    script = (TEMPLATES / "page.js").read_text(encoding="utf-8")

    swatches = {}
    for cell_id in report.shown:
        look = cell_style(cell_id)
        swatches[cell_id] = (look.colour, MARKERS[look.marker])
    return environment.get_template("index.html.j2").render(
        report=report,
        style=Markup(style),
        script=Markup(script),
        script_hash=_to_base64(hashlib.sha256(script.encode()).digest()),
        sections=[part for part in contents if part.text or part.figures or part.readable_tables],
        swatches=swatches,
    )


def _to_base64(data: bytes) -> str:
    return base64.b64encode(data).decode()

"""The report as one HTML file, readable without JavaScript."""

from collections.abc import Sequence
from pathlib import Path

from parking_exp.figure_style import cell_style
from parking_exp.pages.html_page import render_html
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SectionContent

TEMPLATE = Path(__file__).parent / "templates" / "index.html.j2"
MARKERS = {"o": "●", "s": "■", "^": "▲", "D": "◆", "v": "▼", "P": "✚", "X": "✖"}


def render_page(report: ReportData, contents: Sequence[SectionContent]) -> str:
    """Return `index.html`.

    Everything is escaped. Figures are embedded as images, in which nothing is executed.
    """
    swatches = {}
    for cell_id in report.shown:
        look = cell_style(cell_id)
        swatches[cell_id] = (look.colour, MARKERS[look.marker])
    shown_sections = []
    for content in contents:
        if content.text or content.figures or content.readable_tables:
            shown_sections.append(content)
    return render_html(
        TEMPLATE,
        filters={"number": formats.number},
        report=report,
        sections=shown_sections,
        swatches=swatches,
    )

"""The report as one HTML file, readable without JavaScript."""

from collections.abc import Sequence
from pathlib import Path

from parking_exp.figure_style import cell_style
from parking_exp.pages.html_page import render_html
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SectionContent
from parking_exp.statistics import ENOUGH_FOR_A_TEST, largest_hidden_share
from parking_exp.tasks.registry import task_reports

TEMPLATE = Path(__file__).parent / "templates" / "index.html.j2"
MARKERS = {"o": "●", "s": "■", "^": "▲", "D": "◆", "v": "▼", "P": "✚", "X": "✖"}


def render_page(report: ReportData, contents: Sequence[SectionContent]) -> str:
    """Return `index.html`.

    Everything is escaped. Figures are embedded as images, in which nothing is executed.
    """
    return render_html(
        TEMPLATE,
        report=report,
        sections=contents,
        tasks=task_reports(report.tasks),
        largest_hidden_share=largest_hidden_share,
        enough_for_a_test=ENOUGH_FOR_A_TEST,
        cell_style=cell_style,
        markers=MARKERS,
        number=formats.number,
    )

"""Draw the figures of a report: files for a paper, and SVG for the page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from parking_exp.reports.figures.style import clean, report_style
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SECTIONS, Drawn, Figure, Section


@dataclass(frozen=True)
class Picture:
    """One figure of a report, drawn.

    Attributes:
        name: stem of its files.
        title: a few words.
        caption: what is drawn, and what bars and bands are; plain text, to be escaped.
        svg: for a page: themed by `--ink`, `--grid` and `--paper`, with `data-tip` values under the pointer.
        section: id of the section that shows it.
    """

    name: str
    title: str
    caption: str
    svg: str
    section: str


def draw(
    report: ReportData,
    folder: Path,
    formats: Sequence[str] = ("svg", "pdf", "png"),
    sections: Sequence[Section] = SECTIONS,
) -> list[Picture]:
    """Draw the figures that a report has data for.

    Args:
        report: what to draw.
        folder: for `<name>.<format>`; made if it isn't there.
        formats: any of `svg`, `pdf`, `png`.
        sections: whose figures.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    with report_style():
        for section in sections:
            for figure in section.figures:
                for number, (canvas, caption) in enumerate(_drawn(figure, report), start=1):
                    name = figure.name.format(number)
                    svg = canvas.save(name, figure.title, folder, formats)
                    pictures.append(Picture(name, figure.title, clean(caption), svg, section.id))
    return pictures


def _drawn(figure: Figure, report: ReportData) -> Sequence[Drawn]:
    drawn = figure.draw(report)
    if drawn is None:
        return []
    return [drawn] if isinstance(drawn, tuple) else drawn

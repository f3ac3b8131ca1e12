"""Draw the figures of a report and write their files."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from parking_exp.reports.figures.figure_style import clean, report_style
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SECTIONS, Section

# Nothing that differs from one time to the next: the same report gives the same bytes.
_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None},
    "png": {"Software": None},
}


@dataclass(frozen=True)
class Picture:
    """One figure of a report, drawn; its caption is plain text, to be escaped."""

    name: str
    title: str
    caption: str
    svg: bytes
    section: str


def draw(
    report: ReportData,
    folder: Path,
    formats: Sequence[str] = ("svg", "pdf", "png"),
    sections: Sequence[Section] = SECTIONS,
) -> list[Picture]:
    """Draw the figures that a report has data for into a folder, as `<name>.<format>`."""
    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    with report_style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a box stands for what the font lacks; browsers have other fonts
        for section in sections:
            for kind in section.figures:
                for number, (figure, caption) in enumerate(kind.draw(report), start=1):
                    name = kind.name.format(number)
                    svg = _save(figure, folder / name, formats)
                    pictures.append(Picture(name, kind.title, clean(caption), svg, section.id))
    return pictures


def _save(figure: Figure, stem: Path, formats: Sequence[str]) -> bytes:
    """Write a figure in some formats, and return its SVG."""
    if layout := figure.get_layout_engine():
        layout.execute(figure)
        figure.set_layout_engine("none")  # not once more for each format
    drawing = BytesIO()
    figure.savefig(drawing, format="svg", metadata=_METADATA["svg"])
    for kind in formats:
        path = stem.with_name(f"{stem.name}.{kind}")
        if kind == "svg":
            path.write_bytes(drawing.getvalue())
        else:
            figure.savefig(path, format=kind, metadata=_METADATA[kind])
    return drawing.getvalue()

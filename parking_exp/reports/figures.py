"""A report's content -> its pictures: files for a paper, and SVG for the page."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from parking_exp.reports import factor_figures, lot_figures, pair_figures, search_figures, seed_figures
from parking_exp.reports.content import Content
from parking_exp.reports.sheet import Sheet
from parking_exp.reports.style import clean, report_style


@dataclass(frozen=True)
class Picture:
    """One picture of a report.

    Attributes:
        name: stem of its files.
        title: a few words.
        caption: what is drawn, and what bars and bands are; plain text, to be escaped.
        svg: for a page: themed by `--ink`, `--grid` and `--paper`, with `data-tip` values under the pointer.
    """

    name: str
    title: str
    caption: str
    svg: str


Drawing = tuple[str, str, tuple[Sheet, str]]

_BEFORE: list[tuple[str, str, Callable[[Content], tuple[Sheet, str] | None]]] = [
    ("final_success", "Final success, every seed", seed_figures.final_success),
    ("learning_curves", "Learning curves", seed_figures.learning_curves),
    ("time_to_90", "Time to 90 %", seed_figures.time_to_90),
    ("pairwise", "Differences between cells", pair_figures.pairwise),
    ("main_effects", "Main effects", factor_figures.main_effects),
]
_AFTER: list[tuple[str, str, Callable[[Content], tuple[Sheet, str] | None]]] = [
    ("scene_map", "Where on the lot episodes fail", lot_figures.scene_map),
    ("trajectories", "Sampled episodes from above", lot_figures.trajectories),
    ("parallel_coordinates", "What was tried", search_figures.parallel_coordinates),
    ("importance", "Which hyperparameters matter", search_figures.importance),
]


def draw(content: Content, folder: Path, formats: Sequence[str] = ("svg", "pdf", "png")) -> list[Picture]:
    """Draw what the content has data for.

    Args:
        content: of the report.
        folder: for `<name>.<format>`; made if it isn't there.
        formats: any of `svg`, `pdf`, `png`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    with report_style():
        for name, title, (sheet, caption) in _drawings(content):
            pictures.append(Picture(name, title, clean(caption), sheet.save(name, title, folder, formats)))
    return pictures


def _drawings(content: Content) -> Iterator[Drawing]:
    for name, title, make in _BEFORE:
        if drawn := make(content):
            yield name, title, drawn
    for number, drawn in enumerate(factor_figures.interactions(content), start=1):
        yield f"interaction_{number}", "Interaction", drawn
    for name, title, make in _AFTER:
        if drawn := make(content):
            yield name, title, drawn

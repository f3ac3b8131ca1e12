"""A report's content -> its pictures: files for a paper, and SVG for the page."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from parking_exp.reports.data import Content
from parking_exp.reports.figures import cells, factors, pairs, scenes, search
from parking_exp.reports.figures.canvas import Sheet
from parking_exp.reports.figures.style import clean, report_style


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
    ("final_success", "Final success, every seed", cells.final_success),
    ("learning_curves", "Learning curves", cells.learning_curves),
    ("time_to_90", "Time to 90 %", cells.time_to_90),
    ("pairwise", "Differences between cells", pairs.pairwise),
    ("main_effects", "Main effects", factors.main_effects),
]
_AFTER: list[tuple[str, str, Callable[[Content], tuple[Sheet, str] | None]]] = [
    ("scene_map", "Where on the lot episodes fail", scenes.scene_map),
    ("trajectories", "Sampled episodes from above", scenes.trajectories),
    ("parallel_coordinates", "What was tried", search.parallel_coordinates),
    ("importance", "Which hyperparameters matter", search.importance),
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
    for number, drawn in enumerate(factors.interactions(content), start=1):
        yield f"interaction_{number}", "Interaction", drawn
    for name, title, make in _AFTER:
        if drawn := make(content):
            yield name, title, drawn

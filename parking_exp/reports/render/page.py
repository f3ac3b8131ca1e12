"""The report as one HTML file that needs nothing else: no network, no library, and no script to be read."""

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from parking_exp.reports import formats
from parking_exp.reports.data import Cell, Content
from parking_exp.reports.render.listings import Listing, listings
from parking_exp.reports.render.methods import REFERENCES, methods

if TYPE_CHECKING:
    from parking_exp.reports.figures.draw import Picture
    from parking_exp.reports.figures.style import CellStyle

TEMPLATES = Path(__file__).parent / "templates"
MAX_ROWS = 3000
"""A longer table is left to `tables/*.csv`, where its part about the cells in the figures is longer too."""


class Section(NamedTuple):
    """A part of the page: what it asks, and the names of the figures and tables that answer.

    A name that ends in `*` stands for all that begin so.
    """

    id: str
    title: str
    pictures: Sequence[str] = ()
    listings: Sequence[str] = ()


SECTIONS = (
    Section("results", "Which is better", ["final_success*"], ["headline"]),
    Section("curves", "Learning curves", ["learning_curves*", "curves*"]),
    Section("time", "Time to 90 %", ["time_to_90*", "survival*"], ["times"]),
    Section("pairs", "Pair by pair", ["pair*"], ["pairs"]),
    Section(
        "factors", "What each factor does", ["main_effects*", "effects*", "interaction*"], ["effects", "interactions*"]
    ),
    Section("scenes", "Where episodes fail", ["scene*", "failure*"]),
    Section("trajectories", "Seen from above", ["trajector*", "paths*"]),
    Section("search", "Hyperparameters", ["importance*", "parallel*", "hyperparameter*"], ["importance"]),
    Section("more", "More figures", ["*"]),
    Section("seeds", "Every seed", [], ["seeds"]),
)
MARKERS = {
    "o": "M5 .8a4.2 4.2 0 1 1 0 8.4a4.2 4.2 0 1 1 0-8.4z",
    "s": "M1.2 1.2h7.6v7.6h-7.6z",
    "^": "M5 .6l4.6 8.4h-9.2z",
    "v": "M5 9.4l4.6-8.4h-9.2z",
    "D": "M5 0l5 5l-5 5l-5-5z",
    "P": "M3.4 .4h3.2v3h3v3.2h-3v3h-3.2v-3h-3v-3.2h3z",
    "X": "M2.8 .5l2.2 2.2l2.2-2.2l2.3 2.3l-2.2 2.2l2.2 2.2l-2.3 2.3l-2.2-2.2l-2.2 2.2l-2.3-2.3l2.2-2.2l-2.2-2.2z",
}


def page(content: Content, pictures: Sequence["Picture"] = (), styles: "Mapping[str, CellStyle] | None" = None) -> str:
    """Return `index.html`.

    Args:
        content: what to say; everything in it is escaped.
        pictures: figures; their SVG goes in as it is.
        styles: of the cells in the figures, by id; drawn beside their names.
    """
    style, script = (TEMPLATES.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    found, cut = _listings(content)
    return (
        _environment()
        .get_template("index.html.j2")
        .render(
            content=content,
            style=Markup(style),
            script=Markup(script),
            script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
            sections=_sections(pictures, found),
            listings=found,
            cut=cut,
            swatches={cell: _swatch(style) for cell, style in (styles or {}).items()},
            badges=_badges(content),
            methods=list(methods(content)),
            references=REFERENCES,
            stages=_stages(content.cells),
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


def _listings(content: Content) -> tuple[dict[str, Listing], set[str]]:
    """Return all tables, and which of them are about the cells in the figures alone because they would be too long."""
    found = listings(content)
    long = {name for name, listing in found.items() if len(listing.rows) > MAX_ROWS}
    if long:
        short = listings(content, content.shown)
        found |= {name: short[name] for name in long if name in short}
    return found, long


def _sections(pictures: Sequence["Picture"], found: Mapping[str, Listing]) -> list[dict[str, Any]]:
    left = list(pictures)
    made = []
    for section in SECTIONS:
        mine = [picture for picture in left if _matches(picture.name, section.pictures)]
        left = [picture for picture in left if picture not in mine]
        tables = [listing for name, listing in found.items() if _matches(name, section.listings)]
        drawn = [
            {"name": p.name, "title": p.title, "caption": p.caption, "svg": Markup(p.svg), "width": _width(p.svg)}
            for p in mine
        ]
        if drawn or tables:
            made.append({"id": section.id, "title": section.title, "pictures": drawn, "listings": tables})
    return made


def _width(svg: str) -> int:
    """Return the width below which a picture's letters are too small: that of its points on a screen [px]."""
    found = re.search(r'viewBox="\S+ \S+ ([\d.]+)', svg)
    return round(float(found[1]) * 96 / 72) if found else 0


def _matches(name: str, patterns: Sequence[str]) -> bool:
    return any(name == pattern or (pattern[-1] == "*" and name.startswith(pattern[:-1])) for pattern in patterns)


def _badges(content: Content) -> list[tuple[str, str]]:
    badges = []
    if content.quick:
        badges.append(("preliminary", "made while runs may still have been under way"))
    if content.exploratory:
        badges.append(("exploratory", "fewer than 10 seeds in some cell"))
    if n := len(content.warnings):
        badges.append((f"{n} warning{'s' if n > 1 else ''}", "about what makes numbers hard to compare"))
    return badges


def _stages(cells: Sequence[Cell]) -> dict[str, int]:
    """Return how many runs are at each stage, over all cells."""
    stages: dict[str, int] = {}
    for cell in cells:
        for stage, count in cell.counts.items():
            stages[stage] = stages.get(stage, 0) + count
    return {stage: count for stage, count in stages.items() if count}

"""The style of figures: matplotlib's settings, the look of each cell, and labels that fit and can be drawn."""

import textwrap
import unicodedata
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from parking_exp.reports.report_data import Cell

Drawing = tuple[Figure, str]
"""A figure and its caption."""

WIDTH_IN = 6.8  # of every figure: both columns of a paper
SMALL_PT, TINY_PT = 7.0, 6.0
INK, GRID = "#1c1e21", "#d5d8dc"

# Okabe and Ito's palette without black and yellow, and two of Paul Tol's `muted`.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#999933")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")  # one less than colours: no pair repeats in 56 cells
_LINES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.2, 1.2, 1.2)))

_STYLE = Path(__file__).with_name("report.mplstyle")


def report_style() -> AbstractContextManager[None]:
    """Return a context that draws with our settings and matplotlib's defaults, whatever the user's settings are."""
    return matplotlib.style.context(["default", _STYLE])


def new_figure(height: float) -> Figure:
    """Return an empty figure of the full width that arranges its axes and labels itself; `height` in inches."""
    return Figure((WIDTH_IN, height))


@dataclass(frozen=True)
class CellStyle:
    """The look of a cell, which colour vision is not needed to recognise: a colour, a marker and a line style."""

    colour: str
    marker: str
    line: Any

    @property
    def points(self) -> dict[str, Any]:
        """Arguments of `Axes.plot` for markers without a line."""
        return {"color": self.colour, "marker": self.marker, "linestyle": "", "markeredgewidth": 0}


def cell_style(cell_id: str) -> CellStyle:
    """Return the style that follows from a cell's id, `c0`, `c1`, ..., alone: it is the same in all figures."""
    number = int(cell_id[1:])
    line = _LINES[number // len(_COLOURS) % len(_LINES)]
    return CellStyle(_COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)], line)


def clean(text: str) -> str:
    """Return text without control, formatting and unassigned characters; whitespace becomes single spaces."""
    kept = (" " if c.isspace() else c for c in text if c.isspace() or not unicodedata.category(c).startswith("C"))
    return " ".join("".join(kept).split())


def elided(text: str, length: int) -> str:
    """Return clean text, shortened in its middle to at most `length` characters: both ends distinguish cells."""
    text = clean(text)
    if len(text) <= length:
        return text
    return f"{text[: length // 2]}…{text[len(text) - (length - 1) // 2 :]}"


def cell_labels(cells: Sequence[Cell], width: int, lines: int = 1) -> list[str]:
    """Return a label for each cell, wrapped into lines of `width` characters; ambiguous ones end in the cell's id.

    Longer ones than some `lines` of that width are shortened.
    """
    length = width * lines
    texts = [elided(cell.label, length) for cell in cells]
    unique = [
        text if text and texts.count(text) == 1 else f"{elided(cell.label, length - len(cell.id) - 3)} ({cell.id})"
        for cell, text in zip(cells, texts, strict=True)
    ]
    return [textwrap.fill(text, width) if lines > 1 else text for text in unique]


def row_axes(texts: Sequence[str]) -> tuple[Figure, Axes]:
    """Return a figure with a labelled row for each text, the first one at the top."""
    figure = new_figure(0.6 + len(texts) * (0.24 + 0.08 * max(text.count("\n") for text in texts)))
    axes = figure.subplots()
    axes.grid(axis="x")
    axes.spines["left"].set_visible(False)
    axes.set_ylim(len(texts) - 0.5, -0.5)
    axes.set_yticks(range(len(texts)), texts)
    axes.tick_params("y", length=0)
    return figure, axes


def heat_map(
    figure: Figure, values: np.ndarray, texts: Mapping[tuple[int, int], str], colours: tuple[str, float, float]
) -> tuple[Axes, Colorbar]:
    """Draw values, shape (rows, columns), as coloured squares with a text in each, and a colour bar; NaN stays white.

    `colours` are the name of a colour map, and the values at its ends.
    """
    axes = figure.subplots()
    rows, columns = values.shape
    name, low, high = colours
    edges = np.arange(columns + 1) - 0.5, np.arange(rows + 1) - 0.5
    mesh = axes.pcolormesh(*edges, values, cmap=name, vmin=low, vmax=high, edgecolors="white", linewidth=0.6)
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    size = SMALL_PT if columns < 8 else 5.5 if columns < 13 else 4.8
    for (row, column), text in texts.items():
        colour = text_colour(mesh.to_rgba(values[row, column])[:3])
        axes.text(column, row, text, color=colour, ha="center", va="center", linespacing=1.1, fontsize=size)
    bar = figure.colorbar(mesh, ax=axes, pad=0.02, aspect=30)
    bar.outline.set_visible(False)
    return axes, bar


def line_90(axes: Axes, *, vertical: bool = False) -> None:
    """Draw the line of 90 % success."""
    draw = axes.axvline if vertical else axes.axhline
    draw(90, color=INK, linewidth=0.7, linestyle=(0, (2, 2)), alpha=0.7, zorder=1)


def text_colour(background: Any) -> str:
    """Return black or white, whichever is readable on a colour (WCAG's relative luminance)."""
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(background))
    return "black" if 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.18 else "white"


def percentages(values: Sequence[float | None]) -> np.ndarray:
    """Return shares as percentages, NaN where they are unknown. Shape (n,)."""
    return 100 * np.array([np.nan if value is None else value for value in values], dtype=float)

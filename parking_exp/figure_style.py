"""The style of figures: the look of each cell, labels that fit, and axes that figures share."""

import textwrap
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from parking_exp.phrases import printable_line

WIDTH_IN = 6.8  # every figure spans both columns of a paper
PAGE_IN = 8.4  # height of a figure that leaves room for its caption on a page
SMALL_PT = 7.0
INK, GRID = "#1c1e21", "#d5d8dc"

# Okabe and Ito's palette without black and yellow, and two of Paul Tol's `muted`.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#999933")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")  # one less than colours: no pair repeats in 56 cells
_LINES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.2, 1.2, 1.2)))


def report_style() -> AbstractContextManager[None]:
    """Return a context that draws in the style of reports, whatever the user's settings are."""
    return matplotlib.style.context(["default", Path(__file__).with_name("report.mplstyle")])


def new_figure(height: float) -> Figure:
    """Return an empty figure of the full width; `height` in inches."""
    return Figure((WIDTH_IN, height))


@dataclass(frozen=True)
class CellStyle:
    """The look of a cell, which can be told apart without colour vision."""

    colour: str
    marker: str
    line: Any

    @property
    def points(self) -> dict[str, Any]:
        """Arguments of `Axes.plot` for markers without a line."""
        return {"color": self.colour, "marker": self.marker, "linestyle": "", "markeredgewidth": 0}

    @property
    def lines(self) -> dict[str, Any]:
        """Arguments of `Axes.plot` for a line with markers."""
        return {"color": self.colour, "linestyle": self.line, "marker": self.marker}


def cell_style(cell_id: str) -> CellStyle:
    """Return the style of a cell by its id, `c0`, `c1`, ...: it is the same in all figures."""
    number = int(cell_id[1:])
    line = _LINES[number // len(_COLOURS) % len(_LINES)]
    return CellStyle(_COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)], line)


def wrapped_labels(cells: Sequence[Any], width: int, lines: int = 1) -> list[str]:
    """Return the label of each cell in `lines` lines of `width` characters, cut at the end."""
    labels = [printable_line(cell.label) for cell in cells]
    return [textwrap.fill(label, width, max_lines=lines, placeholder="…") for label in labels]


def _row_height(texts: Sequence[str]) -> float:
    return 0.24 + 0.08 * max((text.count("\n") for text in texts), default=0)


def rows_on_page(texts: Sequence[str]) -> int:
    """Return how many rows of `row_axes` fit on a page."""
    return int((PAGE_IN - 0.6) / _row_height(texts))


def row_axes(texts: Sequence[str]) -> tuple[Figure, Axes]:
    """Return a figure with a labelled row for each text, the first one at the top."""
    figure = new_figure(0.6 + len(texts) * _row_height(texts))
    axes = figure.subplots()
    axes.grid(axis="x")
    axes.spines["left"].set_visible(False)
    axes.set_ylim(len(texts) - 0.5, -0.5)
    axes.set_yticks(range(len(texts)), texts)
    axes.tick_params("y", length=0)
    return figure, axes


def time_axis(axes: Axes, label: str) -> None:
    """Let the x axis begin at 0, with engineering prefixes, and draw horizontal grid lines."""
    axes.set_xlim(left=0)
    axes.set_xlabel(label)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.grid(axis="y")


def text_colour(background: Any) -> str:
    """Return black or white, whichever is readable on an RGB(A) colour (luma of ITU-R BT.601)."""
    return "black" if np.dot(background[:3], (0.299, 0.587, 0.114)) > 0.5 else "white"


def percentages(values: Sequence[float | None]) -> np.ndarray:
    """Return shares as percentages, NaN where they are unknown. Shape (n,)."""
    return 100 * np.array(values, dtype=float)  # None becomes NaN

"""Figures of a hyperparameter search: every point that was tried, and which hyperparameters matter."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from parking_exp.errors import quoted_label
from parking_exp.reports import formats
from parking_exp.reports.figures.canvas import Canvas
from parking_exp.reports.figures.cells import row_canvas
from parking_exp.reports.figures.style import FULL_IN, INK, PAPER, SMALL_PT, TEXT_PT, elided
from parking_exp.reports.formats import p_value, rate_text
from parking_exp.reports.report_data import Cell, Factor, ReportData, Setting

MOST_AXES = 8
BAR = "#0072B2"


@dataclass(frozen=True)
class Line:
    """A line of parallel coordinates.

    Attributes:
        settings: the value of each factor.
        height: where it ends on the last axis, 1 being the best.
        tip: its value under the pointer.
    """

    settings: Mapping[str, Setting]
    height: float
    tip: str


def parallel_coordinates(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw each cell of a search as a line across its hyperparameters to its success; trials have a figure like it."""
    order = {item.factor: rank for rank, item in enumerate(report.importance)}
    factors = sorted(report.factors, key=lambda factor: order.get(factor.key, len(order)))[:MOST_AXES]
    tried = [(cell, 100 * cell.success.value) for cell in report.cells if cell.success.value is not None]
    if report.design != "search" or report.tuning is not None or not tried or not factors:
        return None
    low, high, ticks = rate_axis([rate for _, rate in tried])
    lines = [Line(cell.settings, (rate - low) / (high - low), _tip(cell, rate, factors)) for cell, rate in tried]
    left_out = len(report.factors) - len(factors)
    caption = (
        f"Every cell of the search ({len(tried)}) as a line across its hyperparameters to its mean final success; "
        "brighter is better, thick lines are the best tenth."
        + (f" {left_out} less important hyperparameters are left out." if left_out else "")
    )
    return coordinates(lines, factors, ticks, "success (%)"), caption


def rate_axis(rates: Sequence[float]) -> tuple[float, float, list[tuple[float, str]]]:
    """Return ends of an axis that holds rates [%], and its ticks (height, text)."""
    low, high = 10 * np.floor(min(rates) / 10), 10 * np.ceil(max(rates) / 10)
    low, high = (max(0.0, high - 10), max(10.0, high)) if high - low < 10 else (low, high)
    at = np.arange(low, high + 1, 10 if high - low <= 60 else 20)
    return low, high, [((rate - low) / (high - low), f"{rate:.0f}") for rate in at]


def coordinates(lines: Sequence[Line], factors: Sequence[Factor], ticks: list[tuple[float, str]], name: str) -> Canvas:
    """Draw lines across one upright axis for each factor to a last one, which has a name and ticks (height, text)."""
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    lines = sorted(lines, key=lambda line: line.height)
    canvas = Canvas(FULL_IN, 2.75)
    axes = canvas.axes(0.75, 0.16, FULL_IN - 1.2, 2.15)
    axes.set_axis_off()
    axes.set(xlim=(0, len(factors)), ylim=(-0.04, 1.04))
    scales = [Scale(factor, [line.settings for line in lines]) for factor in factors]
    ends = np.array([line.height for line in lines])
    heights = np.column_stack([*([scale.height(line.settings) for line in lines] for scale in scales), ends])
    # Levels that many lines share are spread a little, so that lines don't hide one another.
    for column, scale in enumerate(scales):
        heights[:, column] += scale.spread * ((np.arange(len(lines)) * 0.618034) % 1 - 0.5)
    best = np.arange(len(lines)) >= len(lines) - max(1, len(lines) // 10)
    paths = [np.column_stack([np.arange(len(factors) + 1), row]) for row in heights]
    widths, alphas = (
        np.where(best, 1.8 if len(lines) < 100 else 1.0, 0.8 if len(lines) < 100 else 0.5),
        np.where(best, 1.0, 0.45 if len(lines) < 100 else 0.25),
    )
    colours = colormaps["cividis"](0.05 + 0.9 * ends)
    colours[:, 3] = alphas
    axes.add_collection(LineCollection(paths, colors=colours, linewidths=widths), autolim=False)
    for line, path in zip(lines, paths, strict=True):
        canvas.tip_line(axes, path[np.isfinite(path[:, 1])], line.tip, width=3)
    room = 72 * (FULL_IN - 1.2) / len(factors) - 6
    for column, scale in enumerate(scales):
        _upright(canvas, axes, column, scale.ticks(), (elided(scale.factor.name, room), room))
    _upright(canvas, axes, len(factors), ticks, (name, room), right=True)
    return canvas


def _tip(cell: Cell, rate: float, factors: list[Factor]) -> str:
    settings = ", ".join(f"{factor.name}={formats.level(cell.settings.get(factor.key))}" for factor in factors)
    return f"{quoted_label(cell.label)}: {rate_text(rate / 100)} ({settings})"


def _upright(
    canvas: Canvas, axes: Any, x: float, ticks: list[tuple[float, str]], name: tuple[str, float], right: bool = False
) -> None:
    """Draw one of the parallel axes: its line, ticks [(height, text)] and name."""
    axes.plot([x, x], [0, 1], color=INK, lw=0.8, clip_on=False)
    axes.plot([x] * len(ticks), [at for at, _ in ticks], ls="", marker="_", ms=4, color=INK, clip_on=False)
    canvas.text(axes, x, 1.1, name[0], ha="center", va="bottom", fontsize=TEXT_PT)
    offset = 72 * (FULL_IN - 1.2) / (axes.get_xlim()[1] or 1)
    for at, text in ticks:
        place = x + (5 if right else -5) / offset
        side = "left" if right else "right"
        behind = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.6, "alpha": 0.75}
        canvas.text(axes, place, at, elided(text, 0.62 * name[1], SMALL_PT), ha=side, fontsize=SMALL_PT, bbox=behind)


class Scale:
    """The scale of a factor on an axis from 0 to 1, for these settings of cells or trials."""

    def __init__(self, factor: Factor, settings: Sequence[Mapping[str, Setting]]) -> None:
        self.factor = factor
        values = [one.get(factor.key) for one in settings]
        plain = [v for v in values if isinstance(v, int | float) and not isinstance(v, bool) and np.isfinite(v)]
        self.numeric = factor.numeric and len(plain) > 0 and len(set(plain)) > 1
        self.log = self.numeric and factor.log and min(plain) > 0
        self.levels = sorted({formats.level(value) for value in values})
        if self.numeric:
            self.low, self.high = (self._at(v) for v in (min(plain), max(plain)))
            self.values = sorted(set(plain))
        crowded = len(self.values if self.numeric else self.levels) < min(8, len(settings))
        self.spread = 0.03 if crowded else 0.0

    def _at(self, value: float) -> float:
        return float(np.log10(value)) if self.log else float(value)

    def height(self, settings: Mapping[str, Setting]) -> float:
        """NaN for a number that is not among these settings."""
        value = settings.get(self.factor.key)
        if not self.numeric:
            return (self.levels.index(formats.level(value)) + 0.5) / len(self.levels)
        if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
            return float("nan")
        return (self._at(value) - self.low) / (self.high - self.low)

    def ticks(self) -> list[tuple[float, str]]:
        """(height, text) of at most a handful."""
        if not self.numeric:
            levels = [((k + 0.5) / len(self.levels), text) for k, text in enumerate(self.levels)]
            return levels[:: -(-len(levels) // 14)]
        if len(self.values) <= 6:
            return [((self._at(v) - self.low) / (self.high - self.low), formats.level(v)) for v in self.values]
        at = np.linspace(self.low, self.high, 5)
        if not self.log and all(isinstance(v, int) for v in self.values):
            return [((v - self.low) / (self.high - self.low), f"{v:.0f}") for v in np.unique(np.round(at))]
        return [(k / 4, f"{10**v:.2g}" if self.log else f"{v:.3g}") for k, v in enumerate(at)]


def importance(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw how much of the variance of success each hyperparameter explains alone."""
    names = {factor.key: factor.name for factor in report.factors}
    found = sorted(report.importance, key=lambda item: -item.share)[:16]
    if not found:
        return None
    texts = [elided(names.get(item.factor, item.factor), 2 * 72) for item in found]
    canvas, axes, width = row_canvas(texts, right=0.45)
    shares = [100 * item.share for item in found]
    axes.set(xlabel="variance of success explained alone (%)")
    axes.barh(range(len(found)), shares, height=0.62, color=BAR)
    # The text after the longest bar needs some 55 points.
    axes.set_xlim(0, max(*shares, 1.0) * (1 + 66 / max(30, 72 * width - 66)))
    axes.set_xticks([tick for tick in axes.get_xticks() if tick <= 100])
    for row, item in enumerate(found):
        arrow = "" if not item.direction else " ↑" if item.direction > 0 else " ↓"
        text = f"{p_value(item.p)}{arrow}".strip()
        canvas.text(axes, shares[row] + 0.02 * axes.get_xlim()[1], row, text, fontsize=SMALL_PT, va="center_baseline")
        rank = "" if item.direction is None else f"; rank correlation {item.direction:+.2f}"
        p = f", {p_value(item.p)}" if item.p is not None else ""
        tip = f"{item.factor}: {rate_text(item.share)} of the variance{p}{rank}"
        canvas.tip_box(axes, 0, row - 0.5, axes.get_xlim()[1], 1, tip)
    caption = (
        "Share of the variance of final success over the cells of the search that each hyperparameter explains "
        "alone, with p of a permutation test; ↑: larger values do better, ↓: worse."
    )
    return canvas, caption

"""Figures of a hyperparameter search: every point that was tried, and which hyperparameters matter."""

from typing import Any

import numpy as np

from parking_exp.errors import quoted_label
from parking_exp.reports import formats
from parking_exp.reports.figures.canvas import Canvas
from parking_exp.reports.figures.cells import row_canvas
from parking_exp.reports.figures.style import FULL_IN, INK, PAPER, SMALL_PT, TEXT_PT, elided
from parking_exp.reports.formats import p_value, rate_text
from parking_exp.reports.report_data import Cell, Factor, ReportData

_MOST_AXES = 8
_BAR = "#0072B2"


def parallel_coordinates(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw each cell of a search as a line across its hyperparameters to its success."""
    from matplotlib import colormaps
    from matplotlib.collections import LineCollection

    order = {item.factor: rank for rank, item in enumerate(report.importance)}
    factors = sorted(report.factors, key=lambda factor: order.get(factor.key, len(order)))[:_MOST_AXES]
    tried = [(cell, 100 * cell.success.value) for cell in report.cells if cell.success.value is not None]
    if report.design != "search" or not tried or not factors:
        return None
    tried.sort(key=lambda pair: pair[1])
    canvas = Canvas(FULL_IN, 2.75)
    axes = canvas.axes(0.75, 0.16, FULL_IN - 1.2, 2.15)
    axes.set_axis_off()
    axes.set(xlim=(0, len(factors)), ylim=(-0.04, 1.04))
    low, high = 10 * np.floor(tried[0][1] / 10), 10 * np.ceil(tried[-1][1] / 10)
    low = min(low, high - 10)
    scales = [_Scale(factor, [cell for cell, _ in tried]) for factor in factors]
    success = (np.array([rate for _, rate in tried]) - low) / (high - low)
    heights = np.column_stack([*([scale.height(cell) for cell, _ in tried] for scale in scales), success])
    # Levels that many cells share are spread a little, so that lines don't hide one another.
    for column, scale in enumerate(scales):
        heights[:, column] += scale.spread * ((np.arange(len(tried)) * 0.618034) % 1 - 0.5)
    best = np.arange(len(tried)) >= len(tried) - max(1, len(tried) // 10)
    lines = [np.column_stack([np.arange(len(factors) + 1), row]) for row in heights]
    widths, alphas = (
        np.where(best, 1.8 if len(tried) < 100 else 1.0, 0.8 if len(tried) < 100 else 0.5),
        np.where(best, 1.0, 0.45 if len(tried) < 100 else 0.25),
    )
    colours = colormaps["cividis"](0.05 + 0.9 * success)
    colours[:, 3] = alphas
    axes.add_collection(LineCollection(lines, colors=colours, linewidths=widths), autolim=False)
    for (cell, rate), line in zip(tried, lines, strict=True):
        canvas.tip_line(axes, line[np.isfinite(line[:, 1])], _tip(cell, rate, factors), width=3)
    room = 72 * (FULL_IN - 1.2) / len(factors) - 6
    for column, scale in enumerate(scales):
        _upright(canvas, axes, column, scale.ticks(), (elided(scale.factor.name, room), room))
    rates = np.arange(low, high + 1, 10 if high - low <= 60 else 20)
    ticks = [((rate - low) / (high - low), f"{rate:.0f}") for rate in rates]
    _upright(canvas, axes, len(factors), ticks, ("success (%)", room), right=True)
    left_out = len(report.factors) - len(factors)
    caption = (
        f"Every cell of the search ({len(tried)}) as a line across its hyperparameters to its mean final success; "
        "brighter is better, thick lines are the best tenth."
        + (f" {left_out} less important hyperparameters are left out." if left_out else "")
    )
    return canvas, caption


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


class _Scale:
    """The scale of a factor on an axis from 0 to 1."""

    def __init__(self, factor: Factor, cells: list[Cell]) -> None:
        self.factor = factor
        values = [cell.settings.get(factor.key) for cell in cells]
        plain = [v for v in values if isinstance(v, int | float) and not isinstance(v, bool) and np.isfinite(v)]
        self.numeric = factor.numeric and len(plain) > 0 and len(set(plain)) > 1
        self.log = self.numeric and factor.log and min(plain) > 0
        self.levels = sorted({formats.level(value) for value in values})
        if self.numeric:
            self.low, self.high = (self._at(v) for v in (min(plain), max(plain)))
            self.values = sorted(set(plain))
        crowded = len(self.values if self.numeric else self.levels) < min(8, len(cells))
        self.spread = 0.03 if crowded else 0.0

    def _at(self, value: float) -> float:
        return float(np.log10(value)) if self.log else float(value)

    def height(self, cell: Cell) -> float:
        """NaN for a number that a cell doesn't have."""
        value = cell.settings.get(self.factor.key)
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
    axes.barh(range(len(found)), shares, height=0.62, color=_BAR)
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

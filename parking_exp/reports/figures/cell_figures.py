"""Figures of cells and their seeds: final success and learning curves."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from parking_exp.figure_style import (
    INK,
    SMALL_PT,
    CellStyle,
    cell_style,
    new_figure,
    percentages,
    row_axes,
    time_axis,
    wrapped_labels,
)
from parking_exp.phrases import plural
from parking_exp.report_section import CaptionedFigure
from parking_exp.reports.report_data import CellSummary, Curve, ReportData
from parking_exp.tasks.registry import FAILURES

_GOLDEN = 0.6180339887498949  # its multiples, modulo 1, are spread evenly
_MOST_SEED_LINES = 4  # cells; with more, lines of seeds hide the means
_LINE_90: dict[str, Any] = {
    "color": INK,
    "linewidth": 0.7,
    "linestyle": (0, (2, 2)),
    "alpha": 0.7,
    "zorder": 1,
}


def _count_seeds(counts: Sequence[int]) -> str:
    """Return e.g. `10 seeds per cell` or `3 to 10 seeds per cell`."""
    text = f"{plural(max(counts), 'seed')} per cell"
    return text if len(set(counts)) == 1 else f"{min(counts)} to {text}"


def draw_final_success(report: ReportData) -> Iterator[CaptionedFigure]:
    """Draw every seed as a point, and each cell's mean with its interval."""
    cells = report.shown_cells
    if all(cell.success.value is None for cell in cells):
        return
    figure, axes = row_axes(wrapped_labels(cells, 36, lines=3))
    axes.set_xlabel("final success (% of episodes)")
    axes.axvline(90, **_LINE_90)
    for row, cell in enumerate(cells):
        _draw_seeds_and_mean(axes, row, cell)
    left, right = axes.dataLim.intervalx
    axes.set_xlim(left - 0.03 * (right - left) - 1, 101)
    n_seeds = _count_seeds([cell.success.n for cell in cells])
    yield (
        figure,
        f"Final success over the evaluation episodes. Points: seeds ({n_seeds}), spread vertically "
        "so that they do not overlap; bar: mean with its 95 % interval, where there is one, cut at "
        "0 and 100 %. Dashed: 90 %.",
    )


def _draw_seeds_and_mean(axes: Axes, row: int, cell: CellSummary) -> None:
    """Draw the seeds of a cell in the upper half of its row, and its mean in the lower half."""
    style = cell_style(cell.id)
    rates = [100 * seed.success for seed in cell.seeds if seed.success is not None]
    if not rates:
        at_left = axes.get_yaxis_transform()
        font: dict[str, Any] = {"style": "italic", "fontsize": SMALL_PT}
        axes.text(0.01, row, "no finished seeds", transform=at_left, va="center", **font)
        return
    heights = [row - 0.32 + 0.36 * (k * _GOLDEN % 1) for k in range(len(rates))]
    axes.plot(rates, heights, alpha=0.6, markersize=3.2, **style.points)
    ends = np.clip(percentages([cell.success.low, cell.success.high]), 0, 100)
    axes.plot(ends, [row + 0.24] * 2, color=style.colour, marker="|", markersize=5)
    mean = percentages([cell.success.value])
    axes.plot(mean, row + 0.24, markersize=4.2, **style.points)


def draw_learning_curves(report: ReportData) -> Iterator[CaptionedFigure]:
    """Draw mean success with the range of the seeds, and mean failure rate, against env steps."""
    cells = [cell for cell in report.shown_cells if cell.curve and len(cell.curve.step) > 1]
    if not cells:
        return
    with_seeds = len(cells) <= _MOST_SEED_LINES
    figure = _new_figure_with_legend(cells)
    success, failure = figure.subplots(2, sharex=True, height_ratios=(2, 1))
    n_seeds = []
    for cell in cells:
        assert cell.curve
        n_seeds.append(len(cell.curve.seeds))
        _draw_curve(success, failure, cell.curve, cell_style(cell.id), with_seeds=with_seeds)
    success.axhline(90, **_LINE_90)
    time_axis(success, "")
    time_axis(failure, "env steps")
    success.set(ylim=(-2, 103), ylabel="success (%)")
    names = [name for name in FAILURES if any(name in cell.metrics for cell in cells)]
    failures = " or ".join(names or ["failure"])
    failure.set(ylim=(0, max(10, failure.get_ylim()[1])), ylabel=f"{failures} (%)")
    lines = "thin lines: seeds; " if with_seeds else ""
    yield (
        figure,
        f"Evaluations during training. Above: mean success over seeds ({_count_seeds(n_seeds)}) "
        f"between the lowest and the highest seed; {lines}dashed: 90 %. Below: mean rate of "
        f"{failures}.",
    )


def _draw_curve(
    success: Axes, failure: Axes, curve: Curve, style: CellStyle, *, with_seeds: bool
) -> None:
    if with_seeds:
        for _, step, rates in curve.seeds:
            success.plot(step, percentages(rates), color=style.colour, linewidth=0.5, alpha=0.3)
    low = np.clip(percentages(curve.low), 0, 100)
    high = np.clip(percentages(curve.high), 0, 100)
    success.fill_between(curve.step, low, high, color=style.colour, alpha=0.13, linewidth=0)
    every = max(1, len(curve.step) // 7)
    success.plot(curve.step, percentages(curve.mean), markevery=every, **style.lines)
    failure.plot(curve.step, percentages(curve.failure), markevery=every, **style.lines)


def _new_figure_with_legend(cells: Sequence[CellSummary]) -> Figure:
    """Return a figure with a legend of the cells at the right, at least as high as that."""
    labels = wrapped_labels(cells, 32, lines=8)
    legend_height = 0.4
    for label in labels:
        legend_height += 0.14 + 0.12 * label.count("\n")
    figure = new_figure(max(3.6, legend_height))
    lines = [Line2D([], [], **cell_style(cell.id).lines) for cell in cells]
    figure.legend(lines, labels, loc="outside right upper")
    return figure

"""Figures of comparisons: pairs of cells, and two crossed factors."""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from parking_exp.figure_style import (
    INK,
    SMALL_PT,
    Drawing,
    new_figure,
    percentages,
    row_axes,
    rows_on_page,
    text_colour,
    wrapped_labels,
)
from parking_exp.reports.formats import VERDICTS, level, p_value, points_interval
from parking_exp.reports.report_data import Pair, ReportData


def draw_pairs(report: ReportData) -> Iterator[Drawing]:
    """Draw the differences of final success between the cells of figures, with intervals; many in
    several figures.
    """
    cells = dict(zip(report.shown, wrapped_labels(report.shown_cells, 36, lines=3), strict=True))
    pairs = [
        p
        for p in report.drawn_pairs
        if p.a in cells and p.b in cells and p.difference.value is not None
    ]
    labels = [
        cells[pair.a] if report.reference else f"{cells[pair.a]}\n− {cells[pair.b]}"  # noqa: RUF001
        for pair in pairs
    ]
    reference = report.cell(report.reference).label if report.reference else None
    each = (
        f"Final success minus that of {reference}"
        if reference
        else "Final success of one cell minus another's"
    )
    caption = (
        f"{each}, in percentage points, with 95 % intervals. ▲ the first is better, ▼ worse, ≈ not "
        "distinguishable, "
        f"? too few seeds; p with Bonferroni's correction. {report.family}"
    )
    n_rows = rows_on_page(labels)
    for begin in range(0, len(pairs), n_rows):
        rows = slice(begin, begin + n_rows)
        yield _draw_differences(pairs[rows], labels[rows]), "Continued." if begin else caption


def _draw_differences(pairs: Sequence[Pair], labels: Sequence[str]) -> Figure:
    figure, axes = row_axes(labels)
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.set_xlabel("difference of final success (points)")
    for row, pair in enumerate(pairs):
        value, low, high = percentages(
            [pair.difference.value, pair.difference.low, pair.difference.high]
        )
        axes.plot([low, high], [row, row], color=INK)
        axes.plot(value, row, color=INK, marker="o", markersize=5)
        text = (
            f"{points_interval(pair.difference)}   {VERDICTS[pair.verdict].mark} "
            f"{p_value(pair.p_corrected)}"
        )
        axes.text(
            1.02, row, text, transform=axes.get_yaxis_transform(), fontsize=SMALL_PT, va="center"
        )
    return figure


def draw_two_factors(report: ReportData) -> Iterator[Drawing]:
    """Draw mean success by the two crossed factors that do most, over the settings of the
    others.
    """
    keys = [effect.factor for effect in report.effects_by_size[:2]]
    if len(keys) < 2:
        return
    rows = [
        (*(level(cell.settings[key]) for key in keys), cell.success.value) for cell in report.cells
    ]
    frame = pd.DataFrame(rows, columns=["row", "column", "success"]).dropna()
    row_levels, column_levels = (list(frame[axis].unique()) for axis in ("row", "column"))
    table = frame.pivot_table("success", "row", "column").reindex(
        index=row_levels, columns=column_levels
    )
    percent = 100 * table.to_numpy()
    figure = new_figure(0.9 + 0.3 * len(row_levels))
    axes = figure.subplots()
    mesh = axes.pcolormesh(percent, cmap="cividis", edgecolors="white", linewidth=0.6)
    for row, column in np.argwhere(np.isfinite(percent)):
        colour = text_colour(mesh.to_rgba(percent[row, column]))
        axes.text(
            column + 0.5,
            row + 0.5,
            f"{percent[row, column]:.1f}",
            color=colour,
            ha="center",
            va="center",
        )
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
    row_name, column_name = (
        next(factor.name for factor in report.factors if factor.key == key) for key in keys
    )
    axes.set(xlabel=column_name, ylabel=row_name)
    axes.set_xticks(np.arange(len(column_levels)) + 0.5, column_levels)
    axes.set_yticks(np.arange(len(row_levels)) + 0.5, row_levels)
    figure.colorbar(mesh, ax=axes, pad=0.02, aspect=30).set_label("success (%)")
    yield (
        figure,
        f"Mean final success by {row_name} and {column_name}, in %, averaged over everything else.",
    )

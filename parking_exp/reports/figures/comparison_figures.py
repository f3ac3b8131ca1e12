"""Figures of comparisons: pairs of cells, and two crossed factors."""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from parking_exp.figure_style import (
    INK,
    SMALL_PT,
    new_figure,
    percentages,
    row_axes,
    rows_on_page,
    text_colour,
    wrapped_labels,
)
from parking_exp.report_section import CaptionedFigure
from parking_exp.reports.formats import VERDICTS, level, p_in_words, points_interval_in_words
from parking_exp.reports.report_data import Pair, ReportData


def draw_pairs(report: ReportData) -> Iterator[CaptionedFigure]:
    """Draw the differences of final success between cells, in as many figures as they need."""
    names = dict(zip(report.shown, wrapped_labels(report.shown_cells, 36, lines=3), strict=True))
    pairs = []
    labels = []
    for pair in report.drawn_pairs:
        if pair.a in names and pair.b in names:
            pairs.append(pair)
            labels.append(names[pair.a])
            if not report.reference:
                labels[-1] += f"\n− {names[pair.b]}"  # noqa: RUF001

    difference = "Final success of one cell minus another's"
    if report.reference:
        difference = f"Final success minus that of {report.labels[report.reference]}"
    caption = (
        f"{difference}, in percentage points, with 95 % intervals. ▲ the first is better, ▼ worse, "
        f"≈ not distinguishable, ~ unclear, ? too few seeds. {report.family}"
    )
    n_rows = rows_on_page(labels)
    for begin in range(0, len(pairs), n_rows):
        rows = slice(begin, begin + n_rows)
        yield _draw_differences(pairs[rows], labels[rows]), caption
        caption = "Continued."


def _draw_differences(pairs: Sequence[Pair], labels: Sequence[str]) -> Figure:
    figure, axes = row_axes(labels)
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.set_xlabel("difference of final success (points)")
    at_right = axes.get_yaxis_transform()
    for row, pair in enumerate(pairs):
        ends = [pair.difference.low, pair.difference.high]
        axes.plot(percentages(ends), [row, row], color=INK)
        axes.plot(percentages([pair.difference.value]), row, color=INK, marker="o", markersize=5)
        verdict = f"{VERDICTS[pair.verdict].mark} {p_in_words(pair.difference.p_corrected)}"
        text = f"{points_interval_in_words(pair.difference)}   {verdict}"
        axes.text(1.02, row, text, transform=at_right, fontsize=SMALL_PT, va="center")
    return figure


def draw_two_factors(report: ReportData) -> Iterator[CaptionedFigure]:
    """Draw mean success by the two crossed factors that do most, over the other settings."""
    effects = report.effects_by_size[:2]
    if len(effects) < 2:
        return
    row_key, column_key = [effect.factor for effect in effects]
    row_name = report.factor_names[row_key]
    column_name = report.factor_names[column_key]
    rows = []
    for cell in report.cells:
        row_level = level(cell.settings[row_key])
        column_level = level(cell.settings[column_key])
        rows.append([row_level, column_level, cell.success.value])
    frame = pd.DataFrame(rows, columns=["row", "column", "success"]).dropna()
    table = frame.pivot_table("success", "row", "column", sort=False)
    figure = _draw_map(100 * table, row_name, column_name)
    yield (
        figure,
        f"Mean final success by {row_name} and {column_name}, in %, averaged over everything else.",
    )


def _draw_map(percent: pd.DataFrame, row_name: str, column_name: str) -> Figure:
    """Return a map of rates in per cent, each written into its square."""
    n_rows, n_columns = percent.shape
    figure = new_figure(0.9 + 0.3 * n_rows)
    axes = figure.subplots()
    mesh = axes.pcolormesh(percent.to_numpy(), cmap="cividis", edgecolors="white", linewidth=0.6)
    for (row, column), value in np.ndenumerate(percent.to_numpy()):
        if np.isfinite(value):
            colour = text_colour(mesh.to_rgba(value))
            centre = (column + 0.5, row + 0.5)
            axes.text(*centre, f"{value:.1f}", color=colour, ha="center", va="center")
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)
    axes.set(xlabel=column_name, ylabel=row_name)
    axes.set_xticks(np.arange(n_columns) + 0.5, percent.columns)
    axes.set_yticks(np.arange(n_rows) + 0.5, percent.index)
    figure.colorbar(mesh, ax=axes, pad=0.02, aspect=30).set_label("success (%)")
    return figure

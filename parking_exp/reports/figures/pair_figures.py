"""Figures of pairs of cells: all against all, or all against one."""

from collections.abc import Iterator, Mapping

import numpy as np

from parking_exp.errors import quoted_label
from parking_exp.reports.figures.figure_style import (
    INK,
    SMALL_PT,
    Drawing,
    cell_labels,
    cell_style,
    heat_map,
    new_figure,
    percentages,
    row_axes,
)
from parking_exp.reports.formats import p_value, points, points_interval, probability
from parking_exp.reports.report_data import Pair, ReportData

_VERDICTS = {"a": "▲", "b": "▼", "same": "≈", "unknown": "?"}
_MOST_WITH_P = 12  # cells of a matrix

Pairs = Mapping[tuple[str, str], Pair]


def draw_pairs(report: ReportData) -> Iterator[Drawing]:
    """Draw differences of final success: from the one cell that all are compared with, or between all cells."""
    known = [pair for pair in report.pairs if pair.difference.value is not None]
    both_ways = {(pair.a, pair.b): pair for one_way in known for pair in (one_way, one_way.reversed())}
    return _matrix(report, both_ways) if report.reference is None else _from_reference(report, both_ways)


def _matrix(report: ReportData, pairs: Pairs) -> Iterator[Drawing]:
    cells = [cell for cell in report.shown_cells if any(cell.id in pair for pair in pairs)]
    if not cells:
        return
    n = len(cells)
    ids = [cell.id for cell in cells]
    shown = {(ids.index(a), ids.index(b)): pair for (a, b), pair in pairs.items() if a in ids and b in ids}
    difference, texts = np.full((n, n), np.nan), {}
    for place, pair in shown.items():
        (difference[place],) = percentages([pair.difference.value])
        second = f"\n{_VERDICTS[pair.verdict]} {probability(pair.p_holm)}" if n <= _MOST_WITH_P else ""
        texts[place] = points(pair.difference.value) + second
    most = max(5.0, np.nanmax(np.abs(difference)))
    figure = new_figure(1.0 + 0.3 * n)
    axes, bar = heat_map(figure, difference, texts, ("PuOr", -most, most))
    labels = cell_labels(cells, 32)
    axes.set_yticks(range(n), labels)
    axes.set_xticks(range(n), labels, rotation=90 if n * max(map(len, labels)) > 80 else 0)
    axes.xaxis.tick_top()
    axes.tick_params("x", length=0)
    bar.set_label("row − column (points)")  # noqa: RUF001
    marks = "▲ the row is better, ▼ the column is, ≈ not distinguishable, ? too few seeds"
    second = f"Second line: {marks}, with p corrected by Holm's method. " if n <= _MOST_WITH_P else ""
    yield (
        figure,
        f"Final success of the row's cell minus the column's, in percentage points. {second}{report.family}",
    )


def _from_reference(report: ReportData, pairs: Pairs) -> Iterator[Drawing]:
    reference = report.cell(report.reference or "")
    rows = [(cell, pairs[cell.id, reference.id]) for cell in report.shown_cells if (cell.id, reference.id) in pairs]
    if not rows:
        return
    figure, axes = row_axes(cell_labels([cell for cell, _ in rows], 36, lines=2))
    name = "the baseline" if report.baseline else "the highest mean"
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.set_xlabel(f"difference from {name} (points)")
    for row, (cell, pair) in enumerate(rows):
        style, difference = cell_style(cell.id), pair.difference
        value, low, high = percentages([difference.value, difference.low, difference.high])
        axes.plot([low, high], [row, row], color=style.colour, linewidth=1.6)
        axes.plot(value, row, markersize=5, **style.points)
        text = f"{points_interval(difference)}   {_VERDICTS[pair.verdict]} {p_value(pair.p_holm)}"
        axes.text(1.02, row, text, transform=axes.get_yaxis_transform(), fontsize=SMALL_PT, va="center")
    yield (
        figure,
        f"Final success minus {name}, {quoted_label(reference.label)}, in percentage points, with 95 % intervals. "
        "▲ better than that cell, ▼ worse, ≈ not distinguishable, ? too few seeds; p corrected by Holm's method. "
        f"{report.family}",
    )

"""Figures of pairs of cells: all against all, or all against one."""

from collections.abc import Sequence
from typing import Any

from parking_exp.errors import quoted_label
from parking_exp.reports.figures.canvas import Canvas, text_on, tiles
from parking_exp.reports.figures.cells import row_canvas, row_labels
from parking_exp.reports.figures.style import (
    COLUMN_IN,
    FULL_IN,
    INK,
    PAPER,
    SMALL_PT,
    TINY_PT,
    cell_style,
    clean,
    labels,
    widest,
    width_pt,
)
from parking_exp.reports.formats import p_value, points
from parking_exp.reports.report_data import Cell, Interval, Pair, ReportData

_VERDICTS = {"a": "▲", "b": "▼", "same": "≈", "unknown": "?"}
_MOST_WITH_P = 12
_MOST_WITH_TEXT = 20


def pairwise(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw differences of final success: from the one cell that all are compared with, or between all cells."""
    return _pair_matrix(report) if report.reference is None else _from_reference(report)


def _differences(report: ReportData) -> dict[tuple[str, str], Pair]:
    """Return every pair that has a difference, both ways round."""
    found = {}
    for pair in report.pairs:
        if pair.difference.value is not None:
            found[pair.a, pair.b], found[pair.b, pair.a] = pair, pair.turned()
    return found


def _pair_tip(a: Cell, b: Cell, pair: Pair) -> str:
    parts = [f"{quoted_label(a.label)} minus {quoted_label(b.label)}: {_difference(pair.difference)} points"]
    if pair.p_holm is not None:
        parts.append(f"Holm {p_value(pair.p_holm)}")
    if pair.improvement.value is not None:
        parts.append(f"probability of improvement {pair.improvement.value:.2f}")
    words = {"same": "can't be told apart", "unknown": "too few seeds"}
    return "; ".join(
        [*parts, words.get(pair.verdict, f"{quoted_label((a if pair.verdict == 'a' else b).label)} is better")]
    )


def _difference(interval: Interval) -> str:
    value = points(interval.value or 0.0)
    if interval.low is None or interval.high is None:
        return value
    return f"{value} [{points(interval.low)}, {points(interval.high)}]"


def _pair_matrix(report: ReportData) -> tuple[Canvas, str] | None:
    known = _differences(report)
    cells = [cell for cell in report.shown_cells if any(cell.id in pair for pair in known)]
    shown = {(a.id, b.id) for a in cells for b in cells} & set(known)
    if not shown:
        return None
    short = labels(cells, 1.4 * 72, SMALL_PT)
    n, texts = len(cells), [short[cell.id] for cell in cells]
    left = widest(texts, SMALL_PT) / 72 + 0.15
    width = COLUMN_IN if n <= 3 and left < 1.3 else FULL_IN
    step = min(0.8 if n > 3 else 0.6, (width - left - 0.75) / n)
    row = min(0.34, max(0.24, step))
    across = all(width_pt(text, SMALL_PT) < 72 * step - 4 for text in texts)
    head = 0.25 if across else widest(texts, SMALL_PT) / 72 + 0.12
    canvas = Canvas(left + n * step + 0.75, 0.12 + n * row + head)
    axes = canvas.axes(left, 0.12, n * step, n * row)
    canvas.row_labels(axes, texts, SMALL_PT)
    axes.set(xlim=(-0.5, n - 0.5), xticks=[])
    axes.spines[["left", "bottom"]].set_visible(False)
    for column, text in enumerate(texts):
        style = {"va": "bottom", "ha": "center", "rotation": 0 if across else 90, "fontsize": SMALL_PT}
        canvas.text(axes, column, -0.62, text, **style)
    most = max(5.0, *(abs(100 * (known[key].difference.value or 0)) for key in shown))
    colours = _diverging()
    _fill_matrix(canvas, axes, cells, known, (colours, most))
    tall = min(n * row, 2.2)
    place = (left + n * step + 0.12, 0.12 + (n * row - tall) / 2, 0.1, tall)
    unit = "row − column (points)" if tall > 1.3 else "points"  # noqa: RUF001
    canvas.colour_bar(place, colours, -most, most, unit)
    marks = "▲ the row is better, ▼ the column is, ≈ they can't be told apart, ? too few seeds"
    second = f"Second line: {marks}, with p corrected by Holm's method. " if n <= _MOST_WITH_P else ""
    caption = f"Final success of the row's cell less the column's, in percentage points. {second}{report.family}"
    return canvas, caption.strip()


def _fill_matrix(
    canvas: Canvas, axes: Any, cells: Sequence[Cell], known: dict[tuple[str, str], Pair], scale: tuple[Any, float]
) -> None:
    colours, most = scale
    boxes, fills, n = [], [], len(cells)
    size = TINY_PT if n <= 9 else 5.5 if n <= _MOST_WITH_P else 4.8
    for row, a in enumerate(cells):
        for column, b in enumerate(cells):
            pair = known.get((a.id, b.id))
            if pair is None or pair.difference.value is None:
                continue
            boxes.append((column - 0.5, row - 0.5, 1, 1))
            fills.append(colours(0.5 + 50 * pair.difference.value / most))
            canvas.tip_box(axes, *boxes[-1], _pair_tip(a, b, pair))
            text = points(pair.difference.value)
            if n <= _MOST_WITH_P:
                text += f"\n{_VERDICTS[pair.verdict]} {_short_p(pair.p_holm)}".rstrip()
            if n <= _MOST_WITH_TEXT:
                style = {"ha": "center", "va": "center", "linespacing": 1.1, "fontsize": size}
                axes.text(column, row, text, color=text_on(fills[-1]), **style)
    tiles(axes, boxes, fills, linewidths=0.6, edgecolors=PAPER)


def _short_p(p: float | None) -> str:
    """Return e.g. `<.001`, `.012` or `1`."""
    if p is None:
        return ""
    return "<.001" if p < 0.001 else "1" if p >= 0.995 else f"{p:.3f}"[1:] if p < 0.1 else f"{p:.2f}"[1:]


def _diverging() -> Any:
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("differences", ["#B35806", "#F1A340", "#F7F7F7", "#67A9CF", "#2166AC"])


def _from_reference(report: ReportData) -> tuple[Canvas, str] | None:
    known = _differences(report)
    base = report.cell(report.reference or "")
    name = "the baseline" if report.baseline else "the highest mean"
    rows = [(cell, known[cell.id, base.id]) for cell in report.shown_cells if (cell.id, base.id) in known]
    if not rows:
        return None
    canvas, axes, _ = row_canvas(row_labels([cell for cell, _ in rows]), right=2.0)
    bounds = [(p.difference.value, p.difference.low, p.difference.high) for _, p in rows]
    edge = max(1.0, *(100 * abs(bound) for three in bounds for bound in three if bound is not None))
    lowest = min(0.0, *(100 * bound for three in bounds for bound in three if bound is not None))
    highest = max(0.0, *(100 * bound for three in bounds for bound in three if bound is not None))
    axes.set(xlim=(lowest - 0.06 * edge, highest + 0.06 * edge), xlabel=f"difference from {name} (points)")
    axes.axvline(0, color=INK, lw=0.8)
    for row, (cell, pair) in enumerate(rows):
        look, difference = cell_style(cell.id), pair.difference
        value = 100 * (difference.value or 0.0)
        if difference.low is not None and difference.high is not None:
            axes.plot([100 * difference.low, 100 * difference.high], [row] * 2, color=look.colour, lw=1.6)
        axes.plot([value], [row], marker=look.marker, ms=5, color=look.colour, mec=PAPER, mew=0.6)
        canvas.tip_points(axes, [value], [row], [_pair_tip(cell, base, pair)], radius=5)
        text = f"{_difference(difference)}   {_VERDICTS[pair.verdict]} {p_value(pair.p_holm)}"
        style = {"transform": axes.get_yaxis_transform(), "fontsize": SMALL_PT, "va": "center_baseline"}
        canvas.text(axes, 1.02, row, text.strip(), **style)
    caption = (
        f"Final success less {name}, {quoted_label(clean(base.label))}, in percentage points, with 95 % intervals. "
        "▲ better than that cell, ▼ worse, ≈ can't be told apart, ? too few seeds; p corrected by Holm's method. "
        f"{report.family}"
    )
    return canvas, caption.strip()

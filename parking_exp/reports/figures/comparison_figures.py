"""Figures of comparisons: pairs of cells, levels of factors and their combinations."""

from collections.abc import Iterator, Mapping

import numpy as np
from matplotlib.axes import Axes

from parking_exp.errors import plural, quoted_label
from parking_exp.figure_style import (
    INK,
    SMALL_PT,
    Drawing,
    cell_labels,
    cell_style,
    clean,
    elided,
    heat_map,
    new_figure,
    percentages,
    row_axes,
)
from parking_exp.reports import formats
from parking_exp.reports.formats import p_value, points, points_interval, probability
from parking_exp.reports.report_data import Factor, Interaction, Pair, ReportData, Setting
from parking_exp.statistics import MainEffect

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


def _level(level: Setting, length: int = 20) -> str:
    return elided(formats.level(level), length)


def draw_main_effects(report: ReportData) -> Iterator[Drawing]:
    """Draw each factor's levels, averaged over the other factors."""
    factors = {factor.key: factor for factor in report.factors}
    effects = [e for e in report.effects if e.factor in factors and any(v.effect.value is not None for v in e.levels)]
    if not effects:
        return
    columns = min(4, len(effects))
    rows = -(-len(effects) // columns)
    figure = new_figure(2.3 * rows)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for axes in panels.flat[len(effects) :]:
        axes.remove()
    for axes, effect in zip(panels.flat, effects, strict=False):
        _effect_panel(axes, factors[effect.factor], effect, characters=100 // columns)
    for axes in panels[:, 0]:
        axes.set_ylabel("success (%)")
    partial = "" if all(e.complete for e in effects) else " *: not all combinations have been run."
    yield (
        figure,
        "Mean final success by level of each factor, averaged over the levels of the other factors, with 95 % "
        f"intervals where there are any.{partial}",
    )


def _effect_panel(axes: Axes, factor: Factor, effect: MainEffect, characters: int) -> None:
    """Draw one factor; labels are upright if `characters` are too few for all of them side by side."""
    place = np.arange(len(effect.levels))
    mean, low, high = (
        percentages([getattr(v.effect, name) for v in effect.levels]) for name in ("value", "low", "high")
    )
    axes.vlines(place, low, high, color=INK, linewidth=1.4)
    axes.plot(place, mean, color=INK, linestyle="-" if factor.numeric else "", linewidth=0.7, marker="o", markersize=4)
    texts = [_level(v.level) for v in effect.levels]
    upright = sum(len(text) + 2 for text in texts) > characters
    axes.set_xticks(place, texts, rotation=90 if upright else 0)
    axes.set_xlim(-0.5, len(texts) - 0.5)
    axes.set_xlabel(elided(factor.name, characters) + ("" if effect.complete else " *"))
    axes.grid(axis="y")


def draw_interactions(report: ReportData) -> Iterator[Drawing]:
    """Draw two factors crossed, one figure per table, all on the same scale."""
    means = [100 * mean for table in report.interactions for row in table.mean for mean in row if mean is not None]
    if not means:
        return
    high = max(10.0, 5 * np.ceil(max(means) / 5))
    scale = (min(5 * np.floor(min(means) / 5), high - 10), high)
    names = {factor.key: clean(factor.name) for factor in report.factors}
    for table in report.interactions:
        if any(mean is not None for row in table.mean for mean in row):
            yield _heat_map(table, names, scale)


def _heat_map(table: Interaction, names: Mapping[str, str], scale: tuple[float, float]) -> Drawing:
    mean = np.array([percentages(row) for row in table.mean])
    places = [(row, column) for row, column in np.argwhere(np.isfinite(mean)).tolist()]
    counts = {table.n[row][column] for row, column in places}
    texts = {place: _cell_text(table, *place, with_n=len(counts) > 1) for place in places}
    figure = new_figure(0.8 + 0.14 * len(table.rows) * (1 + max(text.count("\n") for text in texts.values())))
    axes, bar = heat_map(figure, mean, texts, ("cividis", *scale))
    row_name, column_name = names.get(table.row, clean(table.row)), names.get(table.column, clean(table.column))
    axes.set_xticks(range(len(table.columns)), [_level(level, 90 // len(table.columns)) for level in table.columns])
    axes.set_yticks(range(len(table.rows)), [_level(level) for level in table.rows])
    axes.set(xlabel=column_name, ylabel=row_name, title=clean(table.given or ""))
    bar.set_label("success (%)")
    given = f" for {table.given}" if table.given else ""
    has_shares = any(share is not None for row in table.real_share or [] for share in row)
    real = " Last in each: measured share of real transitions in batches." if has_shares else ""
    each = f"{plural(counts.pop(), 'seed')} each" if len(counts) == 1 else "seeds as written"
    return (
        figure,
        f"Mean final success by {row_name} and {column_name}{given}, in %, with 95 % intervals; {each}.{real}",
    )


def _cell_text(table: Interaction, row: int, column: int, *, with_n: bool) -> str:
    """Return the lines in a square: mean, interval, number of seeds, share of real transitions."""
    mean, low, high = percentages([grid[row][column] for grid in (table.mean, table.low, table.high)])
    share = table.real_share[row][column] if table.real_share else None
    lines = [
        f"{mean:.1f}",
        f"[{low:.0f}, {high:.0f}]" if np.isfinite([low, high]).all() else "",
        f"n={table.n[row][column]}" if with_n else "",
        f"{100 * share:.0f} % real" if share is not None else "",
    ]
    return "\n".join(filter(None, lines))

"""Figures of factors: levels of one, and two of them crossed."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from parking_exp.reports import formats
from parking_exp.reports.figures.canvas import Canvas, numbers, text_on, tiles
from parking_exp.reports.figures.style import (
    COLUMN_IN,
    FULL_IN,
    INK,
    PAPER,
    SMALL_PT,
    TEXT_PT,
    TINY_PT,
    clean,
    elided,
    seeds_text,
    widest,
    width_pt,
)
from parking_exp.reports.formats import points, rate_interval
from parking_exp.reports.report_data import Factor, Interaction, Interval, MainEffect, ReportData, Setting


def main_effects(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw each factor's levels, averaged over the other factors."""
    factors = {factor.key: factor for factor in report.factors}
    effects = [e for e in report.effects if e.factor in factors and any(v.effect.value is not None for v in e.levels)]
    if not effects:
        return None
    columns = min(4, len(effects))
    rows = -(-len(effects) // columns)
    width = COLUMN_IN if columns == 1 else FULL_IN
    step = (width - 0.6) / columns
    most = (1.0 if rows == 1 else 0.8) * 72
    texts = {e.factor: [elided(formats.level(v.level), most, SMALL_PT) for v in e.levels] for e in effects}
    places = {e.factor: _positions(factors[e.factor], [v.level for v in e.levels]) for e in effects}
    inner = 72 * (step - 0.2)
    turned = {key: not _fits(texts[key], places[key], inner) for key in texts}
    foot = max([0.12, *(widest(texts[key], SMALL_PT) / 72 for key, needed in turned.items() if needed)]) + 0.3
    canvas = Canvas(width, rows * (1.45 + foot) + 0.1)
    values = [
        100 * b
        for e in effects
        for v in e.levels
        for b in (v.effect.value, v.effect.low, v.effect.high)
        if b is not None
    ]
    span = max(4.0, max(values) - min(values))
    limits = (max(-2.0, min(values) - 0.12 * span), min(102.0, max(values) + 0.12 * span))
    for index, effect in enumerate(effects):
        row, column = divmod(index, columns)
        bottom = (rows - 1 - row) * (1.45 + foot) + foot
        axes = canvas.axes(0.55 + column * step, bottom, step - 0.2, 1.4, grid="y")
        axes.set_ylim(limits)
        if column == 0:
            axes.set_ylabel("success (%)")
        else:
            axes.set_yticklabels([])
        _effect_panel(canvas, axes, effect, places[effect.factor], texts[effect.factor], turned[effect.factor])
        name = elided(factors[effect.factor].name, inner) + ("" if effect.complete else " *")
        place = axes.get_xaxis_transform()
        canvas.text(axes, 0.5 * sum(axes.get_xlim()), -(foot - 0.08) / 1.4, name, transform=place, ha="center")
    partial = "" if all(e.complete for e in effects) else " *: not all combinations have been run."
    caption = (
        "Mean final success by level of each factor, averaged over the levels of the other factors, with 95 % "
        f"intervals where there are any.{partial}"
    )
    return canvas, caption


def _positions(factor: Factor, levels: Sequence[Setting]) -> np.ndarray:
    """Return where levels stand along an axis: numbers by value or its logarithm, others side by side. Shape (n,)."""
    plain = [v for v in levels if isinstance(v, int | float) and not isinstance(v, bool) and np.isfinite(v)]
    if not factor.numeric or len(plain) < len(levels) or len(levels) < 2:
        return np.arange(len(levels), dtype=float)
    if factor.log and min(plain) > 0:
        return np.log10(np.array(plain, dtype=float))
    return np.array(plain, dtype=float)


def _fits(texts: Sequence[str], places: np.ndarray, width: float) -> bool:
    """Return whether labels side by side have room on an axis that is `width` points long."""
    if len(texts) < 2:
        return True
    order = np.argsort(places)
    gaps = np.diff(places[order]) / max(np.ptp(places), 1e-12) * width * 0.8
    sizes = [width_pt(texts[k], SMALL_PT) for k in order]
    return all(gap > (a + b) / 2 + 3 for gap, a, b in zip(gaps, sizes, sizes[1:], strict=False))


def _effect_panel(
    canvas: Canvas, axes: Any, effect: MainEffect, places: np.ndarray, texts: Sequence[str], turned: bool
) -> None:
    span = max(float(np.ptp(places)), 1e-12) if len(places) > 1 else 1.0
    axes.set_xlim(places.min() - span / 8, places.max() + span / 8)
    mean, low, high = (
        100 * numbers([getattr(v.effect, key) for v in effect.levels]) for key in ("value", "low", "high")
    )
    axes.vlines(places, low, high, color=INK, lw=1.4)
    axes.plot(places, mean, color=INK, lw=0.7, alpha=0.5)
    axes.plot(places, mean, ls="", color=INK, marker="o", ms=4, mec=PAPER, mew=0.6)
    axes.set_xticks(places, [])
    transform, last = axes.get_xaxis_transform(), -np.inf
    for place, text in sorted(zip(places, texts, strict=True)):
        at = float(place - places.min()) / span * 72 * 1.2
        if turned and at - last < SMALL_PT:
            continue  # levels that stand closer than lines of text; their values are under the pointer
        last = at
        style = {"rotation": 90 if turned else 0, "ha": "center", "va": "top", "fontsize": SMALL_PT}
        canvas.text(axes, place, -0.05, text, transform=transform, **style)
    known = [(x, y, v) for x, y, v in zip(places, mean, effect.levels, strict=True) if np.isfinite(y)]
    tips = [
        f"{effect.factor} = {formats.level(v.level)}: {rate_interval(v.effect)}, {_cells(v.cells)}" for _, _, v in known
    ]
    canvas.tip_points(axes, [x for x, _, _ in known], [y for _, y, _ in known], tips, radius=5)


def _cells(n: int) -> str:
    return f"{n} cell" if n == 1 else f"{n} cells"


def interactions(report: ReportData) -> list[tuple[Canvas, str]]:
    """Draw two factors crossed, one figure per table, all on the same scale."""
    from matplotlib import colormaps

    tables = [t for t in report.interactions if any(v is not None for row in t.mean for v in row)]
    values = [100 * v for table in tables for row in table.mean for v in row if v is not None]
    if not values:
        return []
    low, high = 5 * np.floor(min(values) / 5), 5 * np.ceil(max(values) / 5)
    low, high = (max(0.0, high - 10), max(10.0, high)) if high - low < 10 else (low, high)
    names = {factor.key: factor.name for factor in report.factors}
    return [_heat_map(table, names, (colormaps["cividis"], float(low), float(high))) for table in tables]


def _heat_map(table: Interaction, names: dict[str, str], scale: tuple[Any, float, float]) -> tuple[Canvas, str]:
    rows = [elided(formats.level(level), 1.3 * 72, SMALL_PT) for level in table.rows]
    left = widest(rows, SMALL_PT) / 72 + 0.36
    width = COLUMN_IN if left + 0.48 * len(table.columns) + 0.7 <= COLUMN_IN else FULL_IN
    step = min(0.8, (width - left - 0.7) / max(1, len(table.columns)))
    columns = [elided(formats.level(level), max(20, 72 * step - 3), SMALL_PT) for level in table.columns]
    share = any(value is not None for line in table.real_share or [] for value in line)
    head, foot = (0.28 if table.given else 0.08), 0.46
    tall, wide = (0.48 if share else 0.36) * len(rows), step * len(columns)
    canvas = Canvas(left + wide + 0.7, foot + tall + head)
    axes = canvas.axes(left, foot, wide, tall)
    canvas.row_labels(axes, rows, SMALL_PT)
    axes.set(xlim=(-0.5, len(columns) - 0.5), xticks=[])
    axes.spines[["left", "bottom"]].set_visible(False)
    background = canvas.blank(0, 0, canvas.width, canvas.height)
    for column, text in enumerate(columns):
        x = 72 * (left + (column + 0.5) * step)
        canvas.text(background, x, 72 * foot - 8, text, ha="center", fontsize=SMALL_PT)
    row_name, column_name = (names.get(key, key) for key in (table.row, table.column))
    canvas.text(background, 72 * (left + wide / 2), 8, elided(column_name, 72 * wide + 40), ha="center")
    canvas.text(background, 8, 72 * (foot + tall / 2), elided(row_name, 72 * tall + 40), rotation=90, ha="center")
    if table.given:
        canvas.text(background, 72 * left, 72 * canvas.height - 9, elided(table.given, 72 * (canvas.width - left)))
    _fill_heat_map(canvas, axes, table, scale)
    canvas.colour_bar((left + wide + 0.12, foot, 0.1, tall), *scale, "success (%)")
    given = f" for {clean(table.given)}" if table.given else ""
    real = " Last in each: measured share of real transitions in batches." if share else ""
    counts = _counts(table)
    many = f"{seeds_text(counts.pop())} each" if len(counts) == 1 else "seeds as written"
    caption = f"Mean final success by {row_name} and {column_name}{given}, in %, with 95 % intervals; {many}.{real}"
    return canvas, clean(caption)


def _counts(table: Interaction) -> set[int]:
    known = np.isfinite([numbers(row) for row in table.mean])
    return {int(n) for n in np.asarray(table.n)[known]}


def _fill_heat_map(canvas: Canvas, axes: Any, table: Interaction, scale: tuple[Any, float, float]) -> None:
    colours, lowest, highest = scale
    counts = _counts(table)
    boxes, fills = [], []
    for r, row in enumerate(table.rows):
        for c, column in enumerate(table.columns):
            mean = Interval(table.mean[r][c], table.low[r][c], table.high[r][c], table.n[r][c])
            where = f"{formats.level(row)} × {formats.level(column)}"  # noqa: RUF001
            box = (c - 0.5, r - 0.5, 1, 1)
            if mean.value is None:
                canvas.tip_box(axes, *box, f"{where}: no finished runs")
                continue
            boxes.append(box)
            fills.append(colours((100 * mean.value - lowest) / (highest - lowest)))
            residual = table.residual[r][c]
            rest = "" if residual is None else f"; {points(residual)} points beside the main effects"
            canvas.tip_box(axes, *box, f"{where}: {rate_interval(mean)}, {seeds_text(mean.n)}{rest}")
            style = {"ha": "center", "va": "center", "color": text_on(fills[-1])}
            small = [] if mean.low is None or mean.high is None else [f"[{100 * mean.low:.0f}, {100 * mean.high:.0f}]"]
            small += [f"n={mean.n}"] if len(counts) > 1 else []
            real = table.real_share[r][c] if table.real_share else None
            lines = [(f"{100 * mean.value:.1f}", TEXT_PT)]
            lines += [(" ".join(small), TINY_PT if len(small) == 1 else 5)] if small else []
            lines += [] if real is None else [(f"{100 * real:.0f} % real", TINY_PT)]
            for line, (text, size) in enumerate(lines):
                place = r + (line - (len(lines) - 1) / 2) * (0.3 if len(lines) > 2 else 0.39)
                axes.text(c, place, text, fontsize=size, **style)
    tiles(axes, boxes, fills, linewidths=0.6, edgecolors=PAPER)

"""Figures of cells and their seeds: final success, learning curves, time to 90 %."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from parking_exp.errors import quoted_label
from parking_exp.reports.figures.canvas import Canvas, legend_height, legend_width, line_90, numbers
from parking_exp.reports.figures.style import (
    COLUMN_IN,
    FULL_IN,
    SMALL_PT,
    cell_style,
    labels,
    seeds_text,
    thousands,
    widest,
)
from parking_exp.reports.formats import rate_interval, rate_text
from parking_exp.reports.report_data import Cell, Curve, ReportData, Seed, Survival

_GOLDEN = 0.6180339887498949
_MOST_SEED_LINES = 4  # cells; with more, lines of seeds hide the means


def seed_counts(cells: Sequence[Cell]) -> str:
    """Return e.g. `10 seeds per cell` or `3 to 10 seeds per cell`."""
    counts = [len(cell.seeds) for cell in cells]
    if not any(counts):
        return "no finished seeds"
    low, high = min(counts), max(counts)
    return f"{seeds_text(high)} per cell" if low == high else f"{low} to {seeds_text(high)} per cell"


def row_canvas(texts: Sequence[str], right: float = 0.15) -> tuple[Canvas, Any, float]:
    """Return a canvas of one row per label, its axes, and their width [in]: one column wide if the labels allow."""
    need = widest(texts) / 72
    width = COLUMN_IN if need <= 1.25 and right < 0.5 else FULL_IN
    left = max(0.6, need + 0.15)
    height = 0.24 * len(texts) + 0.1
    canvas = Canvas(width, height + 0.52)
    axes = canvas.axes(left, 0.44, width - left - right, height, grid="x")
    canvas.row_labels(axes, texts)
    axes.spines["left"].set_visible(False)
    return canvas, axes, width - left - right


def row_labels(cells: Sequence[Cell]) -> list[str]:
    """Return labels for the rows of a figure, as long as a full-width figure can hold."""
    short = labels(cells, 2.7 * 72)
    return [short[cell.id] for cell in cells]


def final_success(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw every seed as a point, and each cell's mean with its interval."""
    cells = report.shown_cells
    known = [seed.success for cell in cells for seed in cell.seeds if seed.success is not None]
    if not known:
        return None
    canvas, axes, _ = row_canvas(row_labels(cells))
    lows = [100 * cell.success.low for cell in cells if cell.success.low is not None]
    floor = max(0.0, min(80.0, 10 * np.floor((min([100 * min(known), *lows]) - 3) / 10)))
    margin = 0.02 * (100 - floor)
    axes.set(xlim=(floor - margin, 100 + margin), xlabel="final success (% of scenes)")
    axes.locator_params(axis="x", steps=[1, 2, 5, 10])
    line_90(axes, vertical=True)
    for row, cell in enumerate(cells):
        _seeds_and_mean(canvas, axes, row, cell, floor)
    caption = (
        f"Final success over the evaluation scenes. Points: seeds ({seed_counts(cells)}), spread upwards so that they "
        "can be told apart; bar: mean with its 95 % interval, where there is one, cut at 0 and 100 %. Dashed: 90 %."
    )
    return canvas, caption


def _seeds_and_mean(canvas: Canvas, axes: Any, row: int, cell: Cell, floor: float) -> None:
    look = cell_style(cell.id)
    seeds = [(seed, 100 * seed.success) for seed in cell.seeds if seed.success is not None]
    if not seeds:
        canvas.text(axes, floor, row, "no finished seeds", fontsize=SMALL_PT, alpha=0.7, style="italic")
        return
    x = [rate for _, rate in seeds]
    y = [row - 0.32 + 0.36 * (k * _GOLDEN % 1) for k in range(len(seeds))] if len(seeds) > 1 else [row - 0.14]
    axes.plot(x, y, ls="", marker=look.marker, ms=3.2, color=look.colour, mec="none", alpha=0.6)
    canvas.tip_points(axes, x, y, [f"{quoted_label(cell.label)}, {_seed_text(seed)}" for seed, _ in seeds])
    mean = cell.success
    if mean.value is None:
        return
    below = row + 0.24
    if mean.low is not None and mean.high is not None:
        low, high = (min(100, max(0, 100 * bound)) for bound in (mean.low, mean.high))
        axes.plot([low, high], [below] * 2, color=look.colour, lw=1.2, marker="|", ms=5, mew=1.2)
    axes.plot([100 * mean.value], [below], marker=look.marker, ms=4.2, color=look.colour, mec="none")
    text = f"{quoted_label(cell.label)}: mean {rate_interval(mean)}, {seeds_text(mean.n)}"
    canvas.tip_points(axes, [100 * mean.value], [below], [text], radius=5)


def _seed_text(seed: Seed) -> str:
    interval = "" if seed.low is None or seed.high is None else f" [{100 * seed.low:.0f}, {100 * seed.high:.0f}]"
    return f"seed {seed.seed}: {rate_text(seed.success)}{interval}"


def learning_curves(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw mean success with its interval, and mean crash rate, against env steps."""
    cells = [cell for cell in report.shown_cells if cell.curve is not None and len(cell.curve.step)]
    if not cells:
        return None
    legend = legend_width(cells)
    lower, upper = 0.95, max(2.0, legend_height(cells) - 1.05)
    canvas = Canvas(FULL_IN, 0.44 + lower + 0.14 + upper + 0.1)
    width = FULL_IN - 0.55 - legend - 0.15
    crash = canvas.axes(0.55, 0.44, width, lower, grid="y")
    success = canvas.axes(0.55, 0.44 + lower + 0.14, width, upper, grid="y")
    last = max(cell.curve.step[-1] for cell in cells if cell.curve)
    highest = max((100 * c for cell in cells if cell.curve for c in cell.curve.crash if c is not None), default=0)
    success.set(xlim=(0, 1.02 * last), ylim=(-2, 103), ylabel="success (%)", xticklabels=[])
    crash.set(xlim=(0, 1.02 * last), ylim=(0, max(10, 1.08 * highest)), ylabel="crash (%)", xlabel="env steps")
    crash.xaxis.set_major_formatter(thousands)
    line_90(success)
    for cell in cells:
        if cell.curve:
            _curve(canvas, success, crash, cell, cell.curve, with_seeds=len(cells) <= _MOST_SEED_LINES)
    canvas.legend(cells, legend)
    lines = "thin lines: seeds; " if len(cells) <= _MOST_SEED_LINES else ""
    caption = (
        f"Evaluations during training. Above: mean success over seeds ({seed_counts(cells)}) with the band of its "
        f"95 % interval; {lines}dashed: 90 %. Below: mean crash rate. Pale where runs of some seeds have ended."
    )
    return canvas, caption


def _curve(canvas: Canvas, success: Any, crash: Any, cell: Cell, curve: Curve, with_seeds: bool) -> None:
    look = cell_style(cell.id)
    steps = np.asarray(curve.step, dtype=float)
    mean, low, high, crashes = (100 * numbers(v) for v in (curve.mean, curve.low, curve.high, curve.crash))
    if with_seeds:
        for _, at, seed_rates in curve.seeds:
            success.plot(at, 100 * numbers(seed_rates), color=look.colour, lw=0.5, alpha=0.3)
    success.fill_between(steps, np.clip(low, 0, 100), np.clip(high, 0, 100), color=look.colour, alpha=0.13, lw=0)
    whole = 1 + int(np.flatnonzero(np.asarray(curve.n) >= max(curve.n))[-1])
    number = int(cell.id[1:]) if cell.id[1:].isdecimal() else 0
    for axes, rates in ((success, mean), (crash, crashes)):
        every = max(1, len(steps) // 7)
        style = {"color": look.colour, "lw": 1.3, "ls": look.line, "marker": look.marker, "ms": 3.2, "mec": "none"}
        axes.plot(steps[:whole], rates[:whole], markevery=(number % every, every), **style)
        if whole < len(steps):
            start = max(0, whole - 1)
            axes.plot(steps[start:], rates[start:], **{**style, "marker": "", "alpha": 0.4})
    _curve_tips(canvas, success, crash, cell, curve)


def _curve_tips(canvas: Canvas, success: Any, crash: Any, cell: Cell, curve: Curve) -> None:
    for axes, rates, word in ((crash, curve.crash, "crash "), (success, curve.mean, "")):
        at, texts = [], []
        for step, rate, low, high, n in zip(curve.step, rates, curve.low, curve.high, curve.n, strict=True):
            if rate is not None and np.isfinite(rate):
                bounds = "" if word or low is None or high is None else f" [{100 * low:.1f}, {100 * high:.1f}]"
                at.append((step, 100 * rate))
                texts.append(
                    f"{quoted_label(cell.label)}, {step:,} env steps: {word}{rate_text(rate)}{bounds}, {seeds_text(n)}"
                )
        canvas.tip_points(axes, [x for x, _ in at], [y for _, y in at], texts)


def time_to_90(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw the share of seeds that have reached 90 %, by env steps and by CPU-seconds."""
    cells = report.shown_cells
    clocks = [(kind, [(cell, getattr(cell, kind)) for cell in cells]) for kind in ("survival", "survival_cpu")]
    panels = [(kind, [(c, s) for c, s in pairs if s is not None and s.n]) for kind, pairs in clocks]
    panels = [(kind, pairs) for kind, pairs in panels if pairs]
    if not panels:
        return None
    named = [cell for cell in cells if any(cell is other for _, pairs in panels for other, _ in pairs)]
    height, legend = max(1.75, legend_height(named) - 0.3), legend_width(named)
    canvas = Canvas(FULL_IN, 0.44 + height + 0.12)
    room = FULL_IN - 0.55 - legend - 0.15
    width = (room - 0.2 * (len(panels) - 1)) / len(panels)
    for column, (_, pairs) in enumerate(panels):
        axes = canvas.axes(0.55 + column * (width + 0.2), 0.44, width, height, grid="y")
        _survival_panel(canvas, axes, pairs)
        if column == 0:
            axes.set_ylabel("seeds at 90 % (%)")
        else:
            axes.set_yticklabels([])
    canvas.legend(named, legend)
    caption = (
        "Share of seeds whose success has reached 90 % in three evaluations in a row (Kaplan and Meier's estimate; "
        f"{seed_counts(named)}). Crosses (+): seeds not there when their observation ended. Bands: 95 % intervals, "
        "left out where no seed got there, whose lines are drawn a little apart."
    )
    return canvas, caption


def _survival_panel(canvas: Canvas, axes: Any, pairs: Sequence[tuple[Cell, Survival]]) -> None:
    last = max(max([*s.time, *s.censored], default=0) for _, s in pairs) or 1
    axes.set(xlim=(0, 1.03 * last), ylim=(-3, 103), xlabel=pairs[0][1].unit)
    axes.xaxis.set_major_formatter(thousands)
    axes.locator_params(axis="x", nbins=5)
    flat = [cell.id for cell, survival in pairs if not survival.k]
    for cell, survival in pairs:
        look = cell_style(cell.id)
        lift = 1.2 * flat.index(cell.id) if cell.id in flat else 0.0  # lines at 0 would hide one another
        end = max([*survival.time, *survival.censored])
        time = np.array([*survival.time, end], dtype=float)
        share, low, high = (100 * numbers([*v, v[-1]]) + lift for v in (survival.reached, survival.low, survival.high))
        if survival.k:
            axes.fill_between(time, low, high, step="post", color=look.colour, alpha=0.07, lw=0)
        axes.plot(time, share, drawstyle="steps-post", color=look.colour, lw=1.3, ls=look.line)
        axes.plot(time[1:-1], share[1:-1], ls="", marker=look.marker, ms=3.2, color=look.colour, mec="none")
        waiting = np.asarray(survival.censored, dtype=float)
        at = share[np.searchsorted(time[:-1], waiting, side="right") - 1] if len(waiting) else waiting
        axes.plot(waiting, at, ls="", marker="+", ms=6, mew=0.9, color=look.colour)
        _survival_tips(canvas, axes, cell, survival, (waiting, at))


def _survival_tips(canvas: Canvas, axes: Any, cell: Cell, survival: Survival, censored: tuple[Any, Any]) -> None:
    texts = []
    for time, share, low, high in zip(survival.time, survival.reached, survival.low, survival.high, strict=True):
        bounds = "" if low is None or high is None else f" [{100 * low:.0f}, {100 * high:.0f}]"
        rate = f"{rate_text(share)}{bounds} of {seeds_text(survival.n)}"
        texts.append(f"{quoted_label(cell.label)}: {rate} by {time:,.0f} {survival.unit}")
    canvas.tip_points(axes, survival.time, [100 * share for share in survival.reached], texts)
    ends, counts = np.unique(censored[0], return_counts=True)
    texts = [
        f"{quoted_label(cell.label)}: {seeds_text(int(n))} not at 90 % after {end:,.0f} {survival.unit}"
        for end, n in zip(ends, counts, strict=True)
    ]
    heights = [float(censored[1][np.flatnonzero(censored[0] == end)[0]]) for end in ends]
    canvas.tip_points(axes, ends, heights, texts, radius=4)

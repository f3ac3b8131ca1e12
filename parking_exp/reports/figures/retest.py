"""Figure of the trials that were trained again on fresh seeds."""

from typing import Any

import numpy as np

from parking_exp.errors import plural
from parking_exp.reports.figures.canvas import Canvas
from parking_exp.reports.figures.cells import row_canvas
from parking_exp.reports.figures.search import BAR
from parking_exp.reports.figures.style import PAPER, SMALL_PT
from parking_exp.reports.report_data import Interval, ReportData
from parking_exp.reports.tuning_data import Objective, Retested
from parking_exp.reports.tuning_findings import difference_text, mean_text, named


def retest(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw the means of re-run trials on tuning seeds and on fresh ones, with the difference in words."""
    tuning = report.tuning
    objective = tuning.retested_on if tuning else None
    if tuning is None or objective is None:
        return None
    drawn = [one for one in tuning.retested if one.tuning_mean.value is not None or one.test_mean.value is not None]
    if not drawn:
        return None
    canvas, axes, _ = row_canvas([f"trial {one.number}" for one in drawn], right=1.75)
    factor, edge = (100, 100.0) if objective.is_rate else (1, np.inf)
    bounds = [b for one in drawn for m in (one.tuning_mean, one.test_mean) for b in (m.value, m.low, m.high)]
    known = [min(edge, factor * bound) for bound in bounds if bound is not None]
    span = max(max(known) - min(known), 1.0)
    unit = "%" if objective.is_rate else "CPU-s"
    axes.set(xlim=(min(known) - 0.05 * span, max(known) + 0.05 * span), xlabel=f"{objective.name} ({unit})")
    for row, one in enumerate(drawn):
        _retested(canvas, axes, (row, factor), one, objective)
    caption = (
        f"{objective.name} of the trials that were trained again: mean and 95 % interval on tuning seeds (hollow), by "
        "which they were chosen, and on fresh ones (filled). At the right: tuning minus test, with Welch's interval."
    )
    return canvas, caption


def _retested(canvas: Canvas, axes: Any, place: tuple[int, int], one: Retested, objective: Objective) -> None:
    """Draw one trial in a row, values times a factor."""
    row, factor = place
    seeds = (
        (one.tuning_mean, one.tuning_missed, len(one.tuning), "tuning"),
        (one.test_mean, one.test_missed, len(one.test), "fresh"),
    )
    for height, (found, missed, n, name) in zip((row - 0.16, row + 0.16), seeds, strict=True):
        if found.value is None:
            continue
        _interval(axes, found, height, factor)
        at, fill = factor * found.value, PAPER if name == "tuning" else BAR
        axes.plot([at], [height], marker="o", ms=4.4, color=BAR, mfc=fill, mew=1.0)
        text = f"{named(one.label)}, {plural(n, f'{name} seed')}: {mean_text(objective, found, missed, n)}"
        canvas.tip_points(axes, [at], [height], [text], radius=5)
    text = difference_text(objective, one.difference) or "missed 95 % on some seeds"
    style = {"transform": axes.get_yaxis_transform(), "fontsize": SMALL_PT, "va": "center_baseline"}
    canvas.text(axes, 1.03, row, text, **style)


def _interval(axes: Any, found: Interval, height: float, factor: int) -> None:
    if found.low is not None and found.high is not None:
        axes.plot([factor * found.low, factor * found.high], [height] * 2, color=BAR, lw=1.2, marker="|", ms=4, mew=1.0)

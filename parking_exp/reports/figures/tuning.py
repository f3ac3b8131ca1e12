"""Figures of a search's trials: history, parameters, budget and Pareto front."""

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any

import numpy as np

from parking_exp.errors import plural
from parking_exp.reports import formats
from parking_exp.reports.figures.canvas import Canvas
from parking_exp.reports.figures.cells import row_canvas
from parking_exp.reports.figures.objective_scale import ObjectiveScale
from parking_exp.reports.figures.search import BAR, MOST_AXES, Line, Scale, coordinates, rate_axis
from parking_exp.reports.figures.style import (
    FULL_IN,
    INK,
    PAPER,
    SMALL_PT,
    TEXT_PT,
    elided,
    thousands,
    width_pt,
)
from parking_exp.reports.report_data import Factor, ReportData
from parking_exp.reports.tuning_data import Objective, Trial, Tuning
from parking_exp.reports.tuning_findings import value_text

_BEST = "#D55E00"
_COLUMNS, _MOST_PANELS = 4, 16
_MARKS = {"pruned": "x", "failed": "+"}


def _missed(tuning: Tuning, *objectives: Objective) -> str:
    """Return what `missed` means where it stands on an axis."""
    some = any(one.missed(t.values[tuning.objectives.index(one)]) for one in objectives for t in tuning.done)
    return " Missed: some of its seeds never held 95 %." if some else ""


def _trial_tip(tuning: Tuning, trial: Trial) -> str:
    n_seeds = len(tuning.tuning_seeds)
    pairs = zip(tuning.objectives, trial.values, strict=False)
    words = ", ".join(f"{one.name} {value_text(one, value, n_seeds)}" for one, value in pairs)
    return f"{trial.label}: {words or trial.reason or trial.state}"


def _best(tuning: Tuning, place: int) -> Trial:
    """Return the trial with the best value of an objective, the first of several."""
    sign = 1 if tuning.objectives[place].higher_is_better else -1
    return max(tuning.done, key=lambda trial: (sign * trial.values[place], -trial.number))


def history(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw the value of every trial that is done, and the best so far, one panel for each objective."""
    tuning = report.tuning
    if tuning is None or not tuning.done:
        return None
    n = len(tuning.objectives)
    height = 1.8 if n == 1 else 1.3
    canvas = Canvas(FULL_IN, 0.44 + n * (height + 0.16))
    for place in range(n):
        axes = canvas.axes(0.75, 0.44 + (n - 1 - place) * (height + 0.16), FULL_IN - 0.9, height, grid="y")
        _history_panel(canvas, axes, tuning, place)
        if place < n - 1:
            axes.set_xticklabels([])
        else:
            axes.set_xlabel("trial")
    over = [state for state in _MARKS if any(trial.state == state for trial in tuning.trials)]
    marks = "; ".join(f"{'×' if state == 'pruned' else '+'}: {state} trials" for state in over)  # noqa: RUF001
    caption = (
        f"Value of each trial that is done, mean over {plural(len(tuning.tuning_seeds), 'tuning seed')}; line: the "
        f"best so far{f'; {marks}, at the edge' if marks else ''}.{_missed(tuning, *tuning.objectives)}"
    )
    return canvas, caption


def _history_panel(canvas: Canvas, axes: Any, tuning: Tuning, place: int) -> None:
    done = tuning.done
    scale = ObjectiveScale(tuning.objectives[place], [trial.values[place] for trial in done])
    last = max(trial.number for trial in tuning.trials)
    axes.set_xlim(-0.02 * (last + 1) - 0.3, 1.02 * last + 0.5)
    axes.locator_params(axis="x", integer=True)
    scale.fit(axes, room=0.14)
    after = [trial for trial in tuning.trials if trial.best]
    line = [scale.at(trial.best[place]) for trial in after]
    axes.plot([trial.number for trial in after], line, drawstyle="steps-post", color=_BEST, lw=1.3)
    x, y = [trial.number for trial in done], [scale.at(trial.values[place]) for trial in done]
    axes.plot(x, y, ls="", marker="o", ms=3.6, color=BAR, mec="none", alpha=0.75)
    low, high = axes.get_ylim()
    edge = low + (0.06 if scale.objective.higher_is_better else 0.94) * (high - low)
    for state, marker in _MARKS.items():
        ended = [trial for trial in tuning.trials if trial.state == state]
        at = [trial.number for trial in ended]
        axes.plot(at, [edge] * len(at), ls="", marker=marker, ms=4, mew=0.9, color=INK, alpha=0.7)
        canvas.tip_points(axes, at, [edge] * len(at), [_trial_tip(tuning, trial) for trial in ended])
    canvas.tip_points(axes, x, y, [_trial_tip(tuning, trial) for trial in done])


def importance(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw the importance of each parameter by PED-ANOVA."""
    tuning = report.tuning
    if tuning is None or not tuning.importance:
        return None
    names = {factor.key: factor.name for factor in tuning.parameters}
    found = list(tuning.importance.items())[:_MOST_PANELS]
    canvas, axes, _ = row_canvas([elided(names.get(key, key), 2 * 72) for key, _ in found], right=0.45)
    shares = [100 * share for _, share in found]
    axes.set(xlabel="share of importance (%)", xlim=(0, 1.12 * max(*shares, 1.0)))
    axes.barh(range(len(found)), shares, height=0.62, color=BAR)
    for row, (key, share) in enumerate(found):
        text = f"{100 * share:.0f} %"
        place = 100 * share + 0.01 * axes.get_xlim()[1]
        canvas.text(axes, place, row, text, fontsize=SMALL_PT, va="center_baseline")
        canvas.tip_box(axes, 0, row - 0.5, axes.get_xlim()[1], 1, f"{key}: {formats.rate_text(share)}")
    several = len(tuning.objectives) > 1
    top = "on or next to the Pareto front" if several else "among the best tenth"
    done = plural(len(tuning.done), "trial")
    hint = " With fewer than 50 trials this is a hint, no more." if len(tuning.done) < 50 else ""
    caption = (
        f"How much each parameter matters for a trial to be {top} of the {done} that are done, by PED-ANOVA (Watanabe "
        f"et al., IJCAI 2023), as shares of the sum.{hint}"
    )
    return canvas, caption


def _by_importance(tuning: Tuning, most: int) -> tuple[list[Factor], str]:
    """Return the parameters that vary, the most important first, and a sentence about those left out."""
    order = {key: rank for rank, key in enumerate(tuning.importance)}
    varying = [factor for factor in tuning.parameters if len(factor.levels) > 1]
    found = sorted(varying, key=lambda factor: order.get(factor.key, len(order)))
    left_out = len(found) - most
    return found[:most], f" {plural(left_out, 'more parameter')} left out." if left_out > 0 else ""


def slices(report: ReportData) -> list[tuple[Canvas, str]]:
    """Draw values against each parameter, one small panel each, and one figure for each objective."""
    tuning = report.tuning
    if tuning is None or len(tuning.done) < 2:
        return []
    factors, left_out = _by_importance(tuning, _MOST_PANELS)
    return [_slices(tuning, place, factors, left_out) for place in range(len(tuning.objectives))] if factors else []


def _slices(tuning: Tuning, place: int, factors: Sequence[Factor], left_out: str) -> tuple[Canvas, str]:
    objective, columns = tuning.objectives[place], min(_COLUMNS, len(factors))
    rows = -(-len(factors) // columns)
    inner, tall, foot = (FULL_IN - 0.85) / _COLUMNS - 0.16, 1.1, 0.5
    canvas = Canvas(0.75 + columns * (inner + 0.16), rows * (tall + foot) + 0.1)
    values = ObjectiveScale(objective, [trial.values[place] for trial in tuning.done])
    for number, factor in enumerate(factors):
        row, column = divmod(number, columns)
        bottom = foot + (rows - 1 - row) * (tall + foot)
        axes = canvas.axes(0.75 + column * (inner + 0.16), bottom, inner, tall, grid="y")
        values.fit(axes)
        if column:
            axes.set(ylabel="", yticklabels=[])
        _slice(canvas, axes, tuning, place, (factor, values, 72 * inner))
    caption = (
        f"{objective.name} of each trial that is done, against each parameter; diamond: the best. A trial without a "
        f"parameter is not in its panel.{_missed(tuning, objective)}{left_out}"
    )
    return canvas, caption


def _slice(canvas: Canvas, axes: Any, tuning: Tuning, place: int, drawn: tuple[Factor, ObjectiveScale, float]) -> None:
    """Draw one panel: its parameter, the scale of values, and its width [pt]."""
    factor, values, room = drawn
    trials = [trial for trial in tuning.done if factor.key in trial.settings]
    axes.set_xlim(-0.12, 1.12)
    below = axes.get_xaxis_transform()
    canvas.text(axes, 0.5, -0.26, elided(factor.name, room), transform=below, ha="center", fontsize=TEXT_PT)
    axes.set_xticks([])
    if not trials:
        return
    scale = Scale(factor, [trial.settings for trial in trials])
    shift = scale.spread * ((np.arange(len(trials)) * 0.618034) % 1 - 0.5)
    x = np.array([scale.height(trial.settings) for trial in trials]) + shift
    y = np.array([values.at(trial.values[place]) for trial in trials])
    axes.plot(x, y, ls="", marker="o", ms=3.2, color=BAR, mec="none", alpha=0.6)
    best = [trial is _best(tuning, place) for trial in trials]
    axes.plot(x[best], y[best], ls="", marker="D", ms=4.4, color=_BEST, mec=PAPER, mew=0.6)
    ticks = _fitting(scale, room / 1.24)
    axes.set_xticks([at for at, _ in ticks], [])
    for at, text in ticks:
        canvas.text(axes, at, -0.06, text, transform=below, ha="center", va="top", fontsize=SMALL_PT)
    canvas.tip_points(axes, x, y, [_trial_tip(tuning, trial) for trial in trials])


def _fitting(scale: Scale, room: float) -> list[tuple[float, str]]:
    """Return ticks (place, text) that fit on an axis `room` points long: levels are shortened, numbers left out."""
    ticks = scale.ticks()
    if not scale.numeric:
        ticks = ticks[:: int(np.ceil(20 * len(ticks) / room))]
        return [(at, elided(text, 1.1 * room / len(ticks) - 2, SMALL_PT)) for at, text in ticks]
    ticks = [(at, text if len(text) < 7 else f"{float(text):.2g}") for at, text in ticks]
    while len(ticks) > 1:
        sizes = [width_pt(text, SMALL_PT) for _, text in ticks]
        gaps = [(right[0] - left[0]) * room for left, right in pairwise(ticks)]
        if all(gap > (one + other) / 2 + 3 for gap, (one, other) in zip(gaps, pairwise(sizes), strict=True)):
            break
        ticks = ticks[::2]
    return ticks


def parallel_coordinates(report: ReportData) -> list[tuple[Canvas, str]]:
    """Draw each trial that is done as a line across its parameters to its value, one figure for each objective."""
    tuning = report.tuning
    if tuning is None or len(tuning.done) < 2:
        return []
    factors, left_out = _by_importance(tuning, MOST_AXES)
    if not factors:
        return []
    drawn = []
    for place, objective in enumerate(tuning.objectives):
        values = [trial.values[place] for trial in tuning.done]
        heights, ticks = _heights(objective, values)
        lines = [
            Line(trial.settings, height, _trial_tip(tuning, trial))
            for trial, height in zip(tuning.done, heights, strict=True)
        ]
        unit = "%" if objective.is_rate else "CPU-s"
        caption = (
            f"Every trial that is done ({len(lines)}) as a line across its parameters to its {objective.name} "
            f"({unit}); brighter and higher is better, thick lines are the best tenth."
            f"{_missed(tuning, objective)}{left_out}"
        )
        drawn.append((coordinates(lines, factors, ticks, objective.name), caption))
    return drawn


def _heights(objective: Objective, values: Sequence[float]) -> tuple[list[float], list[tuple[float, str]]]:
    """Return where values stand on an axis from 0, the worst, to 1, and its ticks (height, text)."""
    if objective.is_rate:
        low, high, ticks = rate_axis([100 * value for value in values])
        return [(100 * value - low) / (high - low) for value in values], ticks
    known, scale = [value for value in values if not objective.missed(value)], ObjectiveScale(objective, values)
    at = np.linspace(min(known), max(known), 5) if len(set(known)) > 1 else known[:1]
    ticks = [(scale.height(value), f"{value:.3g}") for value in at]
    missed = next((value for value in values if objective.missed(value)), None)
    if missed is not None:
        ticks.append((scale.height(missed), "missed"))
    return [scale.height(value) for value in values], ticks


def budget(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw the env steps of trials that are done and of pruned ones, and those that pruning saved."""
    tuning = report.tuning
    if tuning is None or not (tuning.budget.done or tuning.budget.pruned):
        return None
    spent = tuning.budget
    rows = [(f"{spent.n_done} done", spent.done, 0), (f"{spent.n_pruned} pruned", spent.pruned, spent.saved or 0)]
    rows = [row for row in rows if row[1] or row[2]]
    canvas, axes, _ = row_canvas([text for text, _, _ in rows], right=0.3)
    most = max(took + saved for _, took, saved in rows)
    axes.set(xlim=(0, 1.04 * most), xlabel="env steps")
    axes.xaxis.set_major_formatter(thousands)
    axes.locator_params(axis="x", nbins=5)
    for row, (text, took, saved) in enumerate(rows):
        axes.barh([row], [took], height=0.62, color=BAR)
        canvas.tip_box(axes, 0, row - 0.4, took, 0.8, f"{text}: {took:,} env steps")
        if saved:
            style = {"facecolor": "none", "edgecolor": BAR, "linewidth": 0.8, "linestyle": (0, (2, 1.5))}
            axes.barh([row], [saved], left=[took], height=0.62, **style)
            canvas.tip_box(axes, took, row - 0.4, saved, 0.8, f"saved by pruning: {saved:,} env steps")
    pruned = ", and of pruned ones" if spent.n_pruned else ""
    dashed = "; dashed: those that the pruned ones did not take" if spent.saved else ""
    return canvas, f"Env steps of the trials that are done{pruned}{dashed}."


def pareto_front(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw two objectives against each other, for each pair of them, with the trials that no other beats in all."""
    tuning = report.tuning
    if tuning is None or len(tuning.objectives) < 2 or not tuning.done:
        return None
    pairs = list(combinations(range(len(tuning.objectives)), 2))
    columns = min(3, len(pairs))
    inner, tall = (2.5, 2.0) if columns < 3 else (1.54, 1.54)
    rows = -(-len(pairs) // columns)
    canvas = Canvas(columns * (inner + 0.68) + 0.14, rows * (tall + 0.5) + 0.1)
    for number, (across, up) in enumerate(pairs):
        row, column = divmod(number, columns)
        bottom = 0.44 + (rows - 1 - row) * (tall + 0.5)
        axes = canvas.axes(0.7 + column * (inner + 0.68), bottom, inner, tall, grid="both")
        _front_panel(canvas, axes, tuning, across, up)
    best = plural(len(tuning.front), "trial")
    joined = ", joined" if len(pairs) == 1 else ""
    caption = (
        f"Objectives of the {plural(len(tuning.done), 'trial')} that are done, one against the other; "
        f"diamonds{joined}: the {best} that no other beats in all of them.{_missed(tuning, *tuning.objectives)}"
    )
    return canvas, caption


def _front_panel(canvas: Canvas, axes: Any, tuning: Tuning, across: int, up: int) -> None:
    places = []
    for place, axis in ((across, "x"), (up, "y")):
        scale = ObjectiveScale(tuning.objectives[place], [trial.values[place] for trial in tuning.done])
        if axis == "x":
            axes.locator_params(axis="x", nbins=4)
        scale.fit(axes, axis)
        places.append(np.array([scale.at(trial.values[place]) for trial in tuning.done]))
    x, y = places
    best = np.array([trial.number in tuning.front for trial in tuning.done])
    axes.plot(x[~best], y[~best], ls="", marker="o", ms=3.4, color=BAR, mec="none", alpha=0.6)
    if len(tuning.objectives) == 2:
        order = np.argsort(x[best], kind="stable")
        axes.plot(x[best][order], y[best][order], color=_BEST, lw=0.8, alpha=0.7)
    axes.plot(x[best], y[best], ls="", marker="D", ms=4.4, color=_BEST, mec=PAPER, mew=0.6)
    canvas.tip_points(axes, x, y, [_trial_tip(tuning, trial) for trial in tuning.done])

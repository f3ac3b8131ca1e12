"""Figure of a sweep over many hyperparameters: how much of the variance of success each explains."""

from parking_exp.reports.figures.canvas import Canvas
from parking_exp.reports.figures.cells import row_canvas
from parking_exp.reports.figures.style import SMALL_PT, elided
from parking_exp.reports.formats import p_value, rate_text
from parking_exp.reports.report_data import ReportData

BAR = "#0072B2"


def importance(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw how much of the variance of success each hyperparameter explains alone."""
    names = {factor.key: factor.name for factor in report.factors}
    found = sorted(report.importance, key=lambda item: -item.share)[:16]
    if not found:
        return None
    texts = [elided(names.get(item.factor, item.factor), 2 * 72) for item in found]
    canvas, axes, width = row_canvas(texts, right=0.45)
    shares = [100 * item.share for item in found]
    axes.set(xlabel="variance of success explained alone (%)")
    axes.barh(range(len(found)), shares, height=0.62, color=BAR)
    # The text after the longest bar needs some 55 points.
    axes.set_xlim(0, max(*shares, 1.0) * (1 + 66 / max(30, 72 * width - 66)))
    axes.set_xticks([tick for tick in axes.get_xticks() if tick <= 100])
    for row, item in enumerate(found):
        arrow = "" if not item.direction else " ↑" if item.direction > 0 else " ↓"
        text = f"{p_value(item.p)}{arrow}".strip()
        canvas.text(axes, shares[row] + 0.02 * axes.get_xlim()[1], row, text, fontsize=SMALL_PT, va="center_baseline")
        rank = "" if item.direction is None else f"; rank correlation {item.direction:+.2f}"
        p = f", {p_value(item.p)}" if item.p is not None else ""
        tip = f"{item.factor}: {rate_text(item.share)} of the variance{p}{rank}"
        canvas.tip_box(axes, 0, row - 0.5, axes.get_xlim()[1], 1, tip)
    caption = (
        "Share of the variance of final success over the cells of the search that each hyperparameter explains "
        "alone, with p of a permutation test; ↑: larger values do better, ↓: worse."
    )
    return canvas, caption

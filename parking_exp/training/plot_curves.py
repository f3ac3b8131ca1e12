"""Draw the learning curves of a run, `curves.png`."""

from pathlib import Path
from typing import Any

import pandas as pd

# Okabe and Ito's palette, distinguishable with any colour vision.
COLOURS = {"success": "#009E73", "crash": "#D55E00", "timeout": "#56B4E9", "parked": "#000000"}


def learning_curves(metrics: pd.DataFrame, title: str, path: Path) -> None:
    """Draw a run's evaluation rates and returns against env steps, from the columns of `MetricsLog.frame`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 5.6), dpi=150, layout="constrained")
    rates, returns = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])

    def plot(axes: Any, column: str, scale: float = 1, **style: Any) -> None:
        if column in metrics:
            curve = metrics[["step", column]].dropna()
            axes.plot(curve["step"], scale * curve[column], **style)

    for name, colour in COLOURS.items():
        line = "--" if name == "parked" else "-"
        plot(rates, f"eval/{name}_rate", 100, color=colour, label=name, marker="o", markersize=3, linestyle=line)
    plot(returns, "eval/return_mean", color="#0072B2", label="evaluation")
    plot(returns, "rollout/ep_rew_mean", color="#999999", label="training")
    rates.set(ylabel="evaluation episodes (%)", ylim=(-3, 103))
    rates.set_title(title, fontsize=9)
    returns.set(xlabel="env steps", ylabel="mean return")
    for axes in (rates, returns):
        axes.legend(frameon=False, fontsize=9)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)

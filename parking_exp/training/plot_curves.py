"""Draw the learning curves of a run, `curves.png`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from parking_exp.tasks.metrics import Metric


def plot_learning_curves(
    log: pd.DataFrame, metrics: Sequence[Metric], title: str, path: Path
) -> None:
    """Draw a run's evaluation rates and returns against env steps.

    Args:
        log: the frame of `MetricsLog`.
        metrics: the task's metrics; those with a colour are drawn.
        title: the title of the figure.
        path: the path of the image.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 5.6), dpi=150)
    rates, returns = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])

    def plot(axes: Any, column: str, scale: float = 1, **style: Any) -> None:
        if column in log:
            curve = log[["step", column]].dropna()
            axes.plot(curve["step"], scale * curve[column], **style)

    for metric in metrics:
        if metric.colour is not None:
            plot(
                rates,
                f"eval/{metric.key}",
                scale=100,
                marker="o",
                markersize=3,
                color=metric.colour,
                label=metric.name,
                linestyle="-" if metric.is_outcome else "--",
            )
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

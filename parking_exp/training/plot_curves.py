"""Draw the learning curves of a run, `curves.png`."""

from pathlib import Path

import pandas as pd

# Okabe and Ito's palette, told apart with any colour vision.
COLOURS = {"success": "#009E73", "crash": "#D55E00", "timeout": "#56B4E9", "parked": "#000000"}


def learning_curves(metrics: pd.DataFrame, title: str, path: Path) -> None:
    """Draw a run's evaluation rates and returns against env steps.

    Args:
        metrics: columns `step`, `eval/<name>_rate`, `eval/return_mean`, as `MetricsLog.frame` gives them.
        title: of the picture.
        path: of the PNG.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (rates, returns) = plt.subplots(2, 1, figsize=(6.4, 5.6), sharex=True, height_ratios=[2, 1])
    for name, colour in COLOURS.items():
        column = f"eval/{name}_rate"
        if column in metrics:
            curve = metrics[["step", column]].dropna()
            style = {"linestyle": "--"} if name == "parked" else {}
            rates.plot(curve["step"], 100 * curve[column], marker="o", markersize=3, color=colour, label=name, **style)
    rates.set(ylabel="evaluation episodes (%)", ylim=(-3, 103), title=title)
    rates.title.set_fontsize(9)
    rates.legend(frameon=False, ncols=4, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.03))
    for column, label, colour in (
        ("eval/return_mean", "evaluation", "#0072B2"),
        ("rollout/ep_rew_mean", "training", "#999999"),
    ):
        if column in metrics:
            curve = metrics[["step", column]].dropna()
            returns.plot(curve["step"], curve[column], color=colour, label=label)
    returns.set(xlabel="env steps", ylabel="mean return")
    returns.legend(frameon=False, fontsize=9)
    for axes in (rates, returns):
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(path, dpi=150)
    plt.close(figure)

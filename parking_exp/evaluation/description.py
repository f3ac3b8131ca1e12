"""Describe an episodes table in sentences, with confidence intervals."""

import pandas as pd

from parking_exp.evaluation.evaluate_policy import summarise
from parking_exp.evaluation.metrics import METRICS
from parking_exp.statistics import wilson_interval

RATES = [metric for metric in METRICS if metric.is_rate]
MEANS = [metric for metric in METRICS if not metric.is_rate]


def intervals(episodes: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Return the Wilson 95 % interval of each rate: of success_rate, crash_rate, timeout_rate and parked_rate."""
    return {rate.key: wilson_interval(int(rate.values(episodes).sum()), len(episodes)) for rate in RATES}


def describe(episodes: pd.DataFrame) -> str:
    """Return rates with Wilson 95 % intervals, and means of the rest, as lines of text."""
    n, summary, lines = len(episodes), summarise(episodes), []
    for rate, (low, high) in zip(RATES, intervals(episodes).values(), strict=True):
        value = summary[rate.key]
        note = "  (strict: inside the lines, within 10 degrees, stationary)" if rate.name == "parked" else ""
        count = f"{value * n:.0f} of {n}"
        lines.append(f"{rate.name:<8}{value:7.1%}   95 % interval {low:.1%} to {high:.1%}   {count}{note}")
    means = [f"{mean.label.lower()} {summary[mean.key]:.3g} {mean.unit}".rstrip() for mean in MEANS]
    return "\n".join([*lines, f"mean     {', '.join(means)}"])


def success_line(summary: dict[str, float], step: int) -> str:
    """Return one line about an evaluation during training."""
    return f"evaluation at step {step}: {', '.join(f'{rate.name} {summary[rate.key]:.0%}' for rate in RATES)}"

"""Describe an episodes table in sentences, with confidence intervals."""

import pandas as pd

from parking_exp.evaluation.evaluate_policy import summarise
from parking_exp.evaluation.metrics import METRICS
from parking_exp.statistics import wilson_interval


def intervals(episodes: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Return the Wilson 95 % interval of each rate: of success_rate, crash_rate, timeout_rate and parked_rate."""
    return {f"{name}_rate": wilson_interval(count, len(episodes)) for name, count in _counts(episodes).items()}


def describe(episodes: pd.DataFrame) -> str:
    """Return rates with Wilson 95 % intervals, and means of the rest, as lines of text."""
    n = len(episodes)
    lines = []
    for name, count in _counts(episodes).items():
        low, high = wilson_interval(count, n)
        note = "  (strict: inside the lines, within 10 degrees, standing)" if name == "parked" else ""
        lines.append(f"{name:<8}{count / n:7.1%}   95 % interval {low:.1%} to {high:.1%}   {count} of {n}{note}")
    means = summarise(episodes)
    phrases = [metric.phrase(means[metric.key]) for metric in METRICS if not metric.is_rate]
    lines.append(f"mean     {', '.join(phrases)}")
    return "\n".join(lines)


def success_line(summary: dict[str, float], step: int) -> str:
    """Return one line about an evaluation during training."""
    rates = ", ".join(f"{metric.name} {summary[metric.key]:.0%}" for metric in METRICS if metric.is_rate)
    return f"evaluation at step {step}: {rates}"


def _counts(episodes: pd.DataFrame) -> dict[str, int]:
    return {metric.name: int(metric.values(episodes).sum()) for metric in METRICS if metric.is_rate}

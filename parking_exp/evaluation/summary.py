"""An episodes table in words."""

import pandas as pd

from parking_exp.envs.outcomes import OUTCOMES
from parking_exp.evaluation.evaluate import summarise
from parking_exp.statistics import wilson_interval


def intervals(episodes: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Return Wilson 95 % intervals of success_rate, crash_rate, timeout_rate and parked_rate."""
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
    lines.append(
        f"mean     {means['steps_mean']:.1f} steps, return {means['return_mean']:.2f}; at the end "
        f"{means['distance_m_mean']:.2f} m from the slot's centre, {means['heading_error_rad_mean']:.3f} rad off, "
        f"{means['speed_mps_mean']:.2f} m/s"
    )
    return "\n".join(lines)


def success_line(summary: dict[str, float], step: int) -> str:
    """Return one line about an evaluation during training."""
    rates = ", ".join(f"{name} {summary[f'{name}_rate']:.0%}" for name in (*OUTCOMES, "parked"))
    return f"evaluation at step {step}: {rates}"


def _counts(episodes: pd.DataFrame) -> dict[str, int]:
    outcomes: dict[str, int] = {name: int((episodes["outcome"] == name).sum()) for name in OUTCOMES}
    return {**outcomes, "parked": int(episodes["parked"].sum())}

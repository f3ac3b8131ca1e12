"""Tables and lines of run states for a terminal."""

from collections.abc import Iterator, Sequence
from statistics import mean
from typing import Literal

from rich.table import Table

from parking_exp.phrases import quoted_label
from parking_exp.runs.run_state import NO_REASON, STAGES, RunState, by_cell, count_stages


def cell_table(states: Sequence[RunState]) -> Table:
    """Return one row per cell: its runs at each stage, and the mean success of those done."""
    table = Table(box=None, pad_edge=False)
    table.add_column("cell", overflow="fold")
    for stage in STAGES:
        table.add_column(stage, justify="right")
    table.add_column("success", justify="right")
    has_several = len({state.experiment for state in states}) > 1
    cells = by_cell(states)
    for (experiment, _), runs in cells.items():
        label = runs[0].label
        name = f"{experiment}: {label}" if has_several else label
        table.add_row(name, *_counts(runs), _mean_success(runs))
    if len(cells) > 1:
        table.add_row("all", *_counts(states), "", style="bold")
    return table


def _counts(runs: Sequence[RunState]) -> list[str]:
    """Return how many runs are at each stage, as text; zeros are left out."""
    return [str(number or "") for number in count_stages(runs).values()]


def _mean_success(runs: Sequence[RunState]) -> str:
    rates = [run.success_rate for run in runs if run.stage == "done"]
    known = [rate for rate in rates if rate is not None]
    return f"{mean(known):.0%}" if known else ""


def state_lines(
    states: Sequence[RunState], *kinds: Literal["running", "stopped", "failed", "damaged"]
) -> Iterator[str]:
    """Yield a line for every run of each kind: how far it is, or what is wrong."""
    for kind in kinds:
        for state in states:
            text = None
            if kind == "running" and state.stage == "running":
                text = f"{describe_progress(state)}   {state.host or ''}".rstrip()
            elif kind == "stopped" and state.stage == "pending" and state.step:
                text = f"resumes at step {_steps(state)}"
            elif kind == "failed" and state.stage == "failed":
                text = f"{state.reason or NO_REASON}   {state.run_dir}"
            elif kind == "damaged" and state.damaged:
                text = f"status.json can't be read; it counts as {state.stage}   {state.run_dir}"
            if text is not None:
                yield f"{kind:<8} {run_name(state)}: {text}"


def describe_progress(state: RunState) -> str:
    """Say how far a running run is."""
    parts = [f"{_steps(state)} steps"]
    if state.doing == "train" and state.steps_per_s:
        parts.append(f"{state.steps_per_s:.0f} steps/s")
        if state.left_s is not None:
            parts.append(f"{format_duration(state.left_s)} left")
    elif state.doing:
        parts.append(state.doing)
    return ", ".join(parts)


def _steps(state: RunState) -> str:
    """Return how many env steps a run has done: `300 of 1000`, or `300`."""
    if state.total_timesteps:
        return f"{state.step} of {state.total_timesteps}"
    return str(state.step)


def run_name(state: RunState) -> str:
    """Name a run: its cell's label and its seed."""
    return f"{quoted_label(state.label)} seed={state.seed}"


def format_duration(seconds: float) -> str:
    """Write a duration as `3 s`, `12 min` or `5 h 20 min`."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 100:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60} min"

"""The plan of a sweep: its runs, how far each is, which are due, and how long they may take."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from parking_exp.config.cell_labels import label_by_experiment, settings_of
from parking_exp.config.compose import Composed
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate_all
from parking_exp.errors import plural
from parking_exp.runs.run_state import RunState, by_cell, counts, read_state
from parking_exp.runs.state_tables import cell_table, damaged_lines, duration
from parking_exp.sweeps.hydra_launcher import Launch


@dataclass(frozen=True)
class PlannedRun:
    """One run of a sweep: its directory, the label of its cell, and how far it was when the sweep began.

    Attributes:
        retried: whether it is run again if it has failed.
        entries: additional entries of its status.json.
    """

    config: RunConfig
    path: Path
    label: str
    state: RunState
    retried: bool = False
    entries: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_due(self) -> bool:
        """Whether this sweep runs it, unless another process does."""
        if self.state.stage == "failed":
            return self.state.killed or self.retried
        return self.state.stage != "done"


def plan(composed: Sequence[Composed], retry: str | None = None) -> list[PlannedRun]:
    """Check every run of a sweep, and read its state; with `retry`, failed runs are due as well.

    Raises:
        ConfigError: a config is wrong.
    """
    unique = {id(run.cell): run.cell for run in composed}  # a cell is checked once for all its seeds
    cells = {
        key: (config, config.run_dir.parent) for key, config in zip(unique, validate_all(unique.values()), strict=True)
    }
    names = {folder: (folder.parent.name, folder.name) for _, folder in cells.values()}
    labels = label_by_experiment({names[folder]: settings_of(config.plain()) for config, folder in cells.values()})
    runs: dict[Path, PlannedRun] = {}
    for run in composed:
        config, folder = cells[id(run.cell)]
        if run.seed is not None:
            config = config.model_copy(update={"seed": run.seed})
        path = folder / f"seed={config.seed}"
        if path not in runs:
            runs[path] = PlannedRun(config, path, labels[names[folder]], read_state(path), retry is not None)
    return list(runs.values())


def describe(runs: Sequence[PlannedRun], launch: Launch, out: Console) -> None:
    """Print the plan: cells x seeds, what is done, what will run, and how long that may take."""
    states = [run.state.model_copy(update={"label": run.label}) for run in runs]
    out.print(cell_table(states))
    for line in damaged_lines(states):
        out.print(line)
    by_stage, due = counts(states), [run for run in runs if run.is_due and run.state.stage != "running"]
    n_cells, n_seeds = len({run.path.parent for run in runs}), len({run.config.seed for run in runs})
    product = plural(n_cells, "cell")
    if n_cells * n_seeds == len(runs):
        product += f" x {plural(n_seeds, 'seed')}"
    failed = by_stage["failed"] - sum(run.state.stage == "failed" for run in due)
    parts = [f"{by_stage['done']} done", f"{by_stage['running']} running elsewhere" if by_stage["running"] else ""]
    parts += [f"{failed} failed before (retry=failed runs them again)" if failed else "", f"{len(due)} to run"]
    estimate = duration_estimate(states, due, launch.n_jobs) if due else ""
    out.print(f"{product} = {plural(len(runs), 'run')}: {', '.join(filter(None, parts))}{estimate}")


def duration_estimate(states: Sequence[RunState], due: Sequence[PlannedRun], n_jobs: int | None) -> str:
    """Say how long the due runs may take, judged by the finished runs of their cell, or else of the sweep.

    The time of a finished run includes its evaluations, but not the start of its process.
    """
    finished = [state for state in states if state.stage == "done" and state.wall_s and state.step]
    if not finished:
        return "; no run has finished yet to estimate the time from"
    rates = {key: _seconds_per_step(runs) for key, runs in by_cell(finished)}
    rate = _seconds_per_step(finished)
    seconds = sum(
        rates.get((run.state.experiment, run.state.cell), rate) * (run.config.total_timesteps - run.state.step)
        for run in due
    )
    if n_jobs is None:
        return f", about {duration(seconds)} of work"
    parallel = f" with {n_jobs} at a time" if n_jobs > 1 else ""
    return f", about {duration(seconds / min(n_jobs, len(due)))}{parallel}"


def _seconds_per_step(states: Sequence[RunState]) -> float:
    return sum(state.wall_s or 0 for state in states) / sum(state.step for state in states)

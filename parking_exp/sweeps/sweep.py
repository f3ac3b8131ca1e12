"""Plan and run a sweep: describe what is due, write configs, launch, watch, sync the store, sum up.

Its whole state is in the run directories: the same command resumes it, and several sweeps can share
one experiment.
"""

import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from rich.console import Console

from parking_exp.config.cell_labels import label_by_experiment, settings_of
from parking_exp.config.compose import ComposedRun
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate_all
from parking_exp.errors import ConfigError, FailedRunError, plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_state import RunState, Stage, count_stages, read_state
from parking_exp.runs.state_tables import cell_table, run_name, state_lines
from parking_exp.sweeps.hydra_launcher import Launcher
from parking_exp.sweeps.monitor import Monitor
from parking_exp.sweeps.store_writer import StoreWriter
from parking_exp.terminal import console, program
from parking_exp.tracking.client import say_ignored_store
from parking_exp.tracking.mirror import follow_store

POLL_S = 1.0


@dataclass(frozen=True)
class PlannedRun:
    """One run of a sweep: its directory, the label of its cell, and its state when the sweep began.

    Attributes:
        retried: whether it is run again if it has failed.
        entries: additional entries of its status.json.
        cell_number: position of its cell in the plan.
    """

    config: RunConfig
    path: Path
    label: str
    state: RunState
    retried: bool = False
    entries: Mapping[str, Any] = field(default_factory=dict)
    cell_number: int = 0

    @property
    def is_due(self) -> bool:
        """Whether this sweep runs it, unless another process does."""
        if self.state.stage == "failed":
            return self.state.killed or self.retried
        if self.state.stage == "done":
            return self.needs_evaluation and self.evaluation_problem is None
        return True

    @cached_property
    def needs_evaluation(self) -> bool:
        """Whether it is finished, but was evaluated with other settings than those of this
        sweep.
        """
        return self.state.stage == "done" and RunDirectory(self.path).needs_evaluation(self.config)

    @cached_property
    def evaluation_problem(self) -> str | None:
        """Why a finished run can't be evaluated again, or None."""
        return RunDirectory(self.path).evaluation_problem()


def plan(composed: Sequence[ComposedRun], retry: str | None = None) -> list[PlannedRun]:
    """Check every run of a sweep, and read its state; with `retry`, failed runs are due as well."""
    # A cell is checked once for all its seeds.
    unique = {id(run.cell): run.cell for run in composed}
    cells = {
        key: (config, config.run_dir.parent)
        for key, config in zip(unique, validate_all(unique.values()), strict=True)
    }
    _refuse_two_evaluations(cells.values())
    names = {folder: (folder.parent.name, folder.name) for _, folder in cells.values()}
    numbers = {folder: number for number, folder in enumerate(names)}
    labels = label_by_experiment(
        {names[folder]: settings_of(config.plain()) for config, folder in cells.values()}
    )
    runs: dict[Path, PlannedRun] = {}
    for run in composed:
        config, folder = cells[id(run.cell)]
        if run.seed is not None:
            config = config.model_copy(update={"seed": run.seed})
        path = folder / f"seed={config.seed}"
        if path not in runs:
            state = read_state(path)
            label = labels[names[folder]]
            runs[path] = PlannedRun(
                config, path, label, state, retry is not None, cell_number=numbers[folder]
            )
    return list(runs.values())


def _refuse_two_evaluations(cells: Iterable[tuple[RunConfig, Path]]) -> None:
    """Refuse cells that differ in their final evaluation alone: they would be the same runs."""
    settings: dict[Path, dict[str, int]] = {}
    for config, folder in cells:
        evaluation = config.final_settings
        first = settings.setdefault(folder, evaluation)
        for name, value in evaluation.items():
            if value != first[name]:
                raise ConfigError(
                    f"evaluation.{name}={first[name]},{value}: the same runs can't have both; give "
                    "one value, and "
                    f"evaluate them on others with {program('evaluate')}"
                )


def print_plan(runs: Sequence[PlannedRun], out: Console) -> None:
    """Print the plan: cells x seeds, what is done, and what will run."""
    states = [_planned_state(run) for run in runs]
    out.print(cell_table(states))
    for line in state_lines(states, "damaged"):
        out.print(line)
    for run, state in zip(runs, states, strict=True):
        if run.needs_evaluation and run.evaluation_problem is not None:
            out.print(f"kept     {run_name(state)}: {run.evaluation_problem}")
    n_reevaluated = sum(run.is_due for run in runs if run.state.stage == "done")
    stages = ("pending", "failed")
    by_stage, due = (
        count_stages(states),
        [run for run in runs if run.is_due and run.state.stage in stages],
    )
    n_cells, n_seeds = (
        len({run.path.parent for run in runs}),
        len({run.config.seed for run in runs}),
    )
    product = plural(n_cells, "cell")
    if n_cells * n_seeds == len(runs):
        product += f" x {plural(n_seeds, 'seed')}"
    failed = by_stage["failed"] - sum(run.state.stage == "failed" for run in due)
    parts = [f"{by_stage['done']} done"]
    parts += [f"{n_reevaluated} to evaluate again" if n_reevaluated else ""]
    parts += [f"{by_stage['running']} running elsewhere" if by_stage["running"] else ""]
    parts += [
        f"{failed} failed before (retry=failed runs them again)" if failed else "",
        f"{len(due)} to run",
    ]
    out.print(f"{product} = {plural(len(runs), 'run')}: {', '.join(filter(None, parts))}")


def _planned_state(run: PlannedRun) -> RunState:
    """Return a run's state as the plan shows it: one that is evaluated again is pending."""
    changes = {"label": run.label}
    if run.state.stage == "done" and run.is_due:
        changes["stage"] = "pending"
    return run.state.model_copy(update=changes)


def sweep(runs: Sequence[PlannedRun], launcher: Launcher, *, dry_run: bool = False) -> None:
    """Print the plan, run what is due, and print the results.

    Raises:
        FailedRunError: not all runs are done at the end.
        InterruptedRunError: a signal stopped it.
    """
    out, paths = console(), [run.path for run in runs]
    print_plan(runs, out)
    if dry_run:
        return
    due = [run for run in runs if run.is_due]
    for run in due:
        entries = {**run.entries, "cell_number": run.cell_number}
        RunDirectory(run.path).write_plan(run.config, run.label, run.state.started, entries=entries)
    _number_finished_runs([run for run in runs if run not in due])
    for run in runs:
        follow_store(RunDirectory(run.path), run.config)
    if any(run.config.tracking.mlflow and run.config.tracking.uri is None for run in due):
        say_ignored_store()
    try:
        configs = [run.config for run in runs]
        with (
            Monitor(lambda: paths, len(paths)) as monitor,
            StoreWriter(lambda: paths, configs, monitor.say),
        ):
            _launch_all([run.path for run in due], launcher, monitor)
    finally:
        states = [read_state(path) for path in paths]
        if due:
            out.print(cell_table(states))
        for line in state_lines(states, "stopped", "failed"):
            out.print(line)
    _check_all_done(states)


def _number_finished_runs(runs: Sequence[PlannedRun]) -> None:
    """Write the cell's place in this plan into the runs that an earlier plan has begun."""
    for run in runs:
        if run.state.cell_number is None:
            with suppress(OSError):  # a directory that can't be written keeps its order
                RunDirectory(run.path).update(durable=False, cell_number=run.cell_number)


def _launch_all(due: list[Path], launcher: Launcher, monitor: Monitor) -> None:
    """Launch what is due, wait for runs that other sweeps have taken, and resume those left
    unfinished.
    """
    while due:
        free = [path for path in due if read_state(path).stage != "running"]
        if free:
            if problem := launcher.train(free):
                monitor.say(f"error: {problem}")
        else:
            time.sleep(POLL_S)
        stages = {path: read_state(path).stage for path in due}
        due = [
            path
            for path in due
            if stages[path] == "running" or (stages[path] == "pending" and path not in free)
        ]


def _check_all_done(states: Sequence[RunState]) -> None:
    """Raise FailedRunError unless every run is done."""
    by_stage = count_stages(states)
    words: dict[Stage, str] = {
        "failed": "failed",
        "pending": "not done",
        "running": "still running",
    }
    if not (
        parts := [f"{by_stage[stage]} {word}" for stage, word in words.items() if by_stage[stage]]
    ):
        return
    advice = (
        "; rerun the same command to resume"
        if by_stage["pending"] or any(s.killed for s in states)
        else ""
    )
    if any(state.stage == "failed" and not state.killed for state in states):
        advice += "; retry=failed runs failed ones again"
    raise FailedRunError(f"of {plural(len(states), 'run')}, {' and '.join(parts)}{advice}")

"""Plan and run a sweep: describe what is due, write configs, launch, watch, sync, sum up.

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

from parking_exp.config.cell_labels import label_by_experiment
from parking_exp.config.compose import ComposedCell, ComposedRun
from parking_exp.config.schema import RunConfig
from parking_exp.config.settings import flatten_config
from parking_exp.config.validate import validate_all
from parking_exp.errors import ConfigError, FailedRunError
from parking_exp.evaluation.init_sources import pin_source
from parking_exp.phrases import plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_plans import write_plan
from parking_exp.runs.run_state import RunState, count_stages, describe_unfinished, read_state
from parking_exp.runs.state_tables import cell_table, run_name, state_lines
from parking_exp.sweeps.launchers import Launcher
from parking_exp.sweeps.monitor import Monitor
from parking_exp.terminal import command_of, make_console
from parking_exp.tracking.client import say_ignored_store
from parking_exp.tracking.store_writer import StoreWriter
from parking_exp.tracking.sync import adopt_store

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
        """Whether it is finished, but was evaluated with settings other than this sweep's."""
        return self.state.stage == "done" and RunDirectory(self.path).needs_evaluation(self.config)

    @cached_property
    def evaluation_problem(self) -> str | None:
        """Why a finished run can't be evaluated again, or None."""
        return RunDirectory(self.path).evaluation_problem()


@dataclass(frozen=True)
class _CheckedCell:
    """A cell of a sweep, checked; each run replaces the seed of its config."""

    config: RunConfig
    folder: Path

    @property
    def identity(self) -> tuple[str, str]:
        """Its experiment, and its name in it."""
        return self.folder.parent.name, self.folder.name


def plan(composed: Sequence[ComposedRun], retry: str | None = None) -> list[PlannedRun]:
    """Check every run of a sweep, and read its state; with `retry`, failed runs are due as well."""
    cells = _check_cells(composed)
    _refuse_two_evaluations(cells.values())
    settings = {cell.identity: flatten_config(cell.config.plain()) for cell in cells.values()}
    labels = label_by_experiment(settings)
    numbers = {identity: number for number, identity in enumerate(settings)}

    runs: dict[Path, PlannedRun] = {}
    for run in composed:
        cell = cells[run.cell]
        config = cell.config
        if run.seed is not None:
            config = config.model_copy(update={"seed": run.seed})
        path = cell.folder / f"seed={config.seed}"
        if path not in runs:
            runs[path] = PlannedRun(
                config=config,
                path=path,
                label=labels[cell.identity],
                state=read_state(path),
                retried=retry is not None,
                cell_number=numbers[cell.identity],
            )
    return list(runs.values())


def _check_cells(composed: Sequence[ComposedRun]) -> dict[ComposedCell, _CheckedCell]:
    """Check each cell once for all its seeds."""
    cells = dict.fromkeys(run.cell for run in composed)
    configs = validate_all(cell.config for cell in cells)
    checked = {}
    for cell, config in zip(cells, map(pin_source, configs), strict=True):
        checked[cell] = _CheckedCell(config, config.run_dir.parent)  # hashing it takes time
    return checked


def _refuse_two_evaluations(cells: Iterable[_CheckedCell]) -> None:
    """Refuse cells that differ in their final evaluation alone: they would be the same runs."""
    settings: dict[Path, dict[str, int]] = {}
    for cell in cells:
        evaluation = cell.config.final_settings
        first = settings.setdefault(cell.folder, evaluation)
        for name, value in evaluation.items():
            if value != first[name]:
                raise ConfigError(
                    f"evaluation.{name}={first[name]},{value}: the same runs can't have both; give "
                    f"one value, and evaluate them on others with {command_of('evaluate')}"
                )


def print_plan(runs: Sequence[PlannedRun], out: Console) -> None:
    """Print the plan: how many runs of each cell are at each stage, and how many will run."""
    states = [_planned_state(run) for run in runs]
    out.print(cell_table(states))
    for line in state_lines(states, "damaged"):
        out.print(line)
    for run, state in zip(runs, states, strict=True):
        if run.needs_evaluation and run.evaluation_problem is not None:
            out.print(f"kept     {run_name(state)}: {run.evaluation_problem}")
    due_stages = [run.state.stage for run in runs if run.is_due and run.state.stage != "running"]
    line = f"{plural(len(runs), 'run')}, {len(due_stages)} to run"
    if "done" in due_stages:
        line += f", {due_stages.count('done')} of them for another evaluation only"
    out.print(line)


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
    starting_from_others = [
        run.config for run in runs if run.is_due and run.config.init is not None
    ]
    if starting_from_others:
        from parking_exp.training.warm_start import check_sources  # imports torch

        check_sources(starting_from_others)
    out = make_console()
    print_plan(runs, out)
    if dry_run:
        return
    _write_plans(runs)
    due = [run.path for run in runs if run.is_due]
    paths = [run.path for run in runs]
    monitor = Monitor(lambda: paths, len(paths))
    try:
        writer = StoreWriter([run.config for run in runs], monitor.say)
        with monitor, writer.syncing(lambda: paths):
            _launch_all(due, launcher, monitor)
    finally:
        states = [read_state(path) for path in paths]
        if due:
            out.print(cell_table(states))
            for folder in dict.fromkeys(path.parents[1] for path in paths):
                out.print(f"runs in {folder}")
        for line in state_lines(states, "stopped", "failed"):
            out.print(line)
    _check_all_done(states)


def _write_plans(runs: Sequence[PlannedRun]) -> None:
    """Write the files of due runs, and complete the cell number and the store of other runs."""
    for run in runs:
        directory = RunDirectory(run.path)
        if run.is_due:
            write_plan(
                directory,
                run.config,
                run.label,
                run.state.started,
                cell_number=run.cell_number,
                **run.entries,
            )
        elif run.state.cell_number is None:
            with suppress(OSError):  # a directory that can't be written keeps its order
                directory.update_status(durable=False, cell_number=run.cell_number)
        adopt_store(directory, run.config)
    tracking = [run.config.tracking for run in runs if run.is_due]
    if any(options.mlflow and options.uri is None for options in tracking):
        say_ignored_store()


def _launch_all(due: list[Path], launcher: Launcher, monitor: Monitor) -> None:
    """Launch what is due, wait for runs of other sweeps, and resume those left unfinished."""
    while due:
        free = [path for path in due if read_state(path).stage != "running"]
        if free:
            problem = launcher.train(free)
            if problem:
                monitor.say(f"error: {problem}")
        else:
            time.sleep(POLL_S)
        launched = set(free)
        due = [path for path in due if _is_left(path, launched=path in launched)]


def _is_left(path: Path, *, launched: bool) -> bool:
    """Return whether a run is still to do: another sweep trains it, or has left it unfinished."""
    stage = read_state(path).stage
    return stage == "running" or (stage == "pending" and not launched)


def _check_all_done(states: Sequence[RunState]) -> None:
    """Raise FailedRunError unless every run is done."""
    by_stage = count_stages(states)
    parts = describe_unfinished(by_stage)
    if not parts:
        return
    failed = [state.killed for state in states if state.stage == "failed"]
    advice = ""
    if by_stage["pending"] or True in failed:
        advice += "; rerun the same command to resume"
    if False in failed:
        advice += "; retry=failed runs failed ones again"
    raise FailedRunError(f"of {plural(len(states), 'run')}, {' and '.join(parts)}{advice}")

"""A sweep: what there is to do is planned, frozen, launched, watched, and summed up.

All that is known lies in the run directories, so that a sweep can be typed again in whatever state it was left, and
several can share one experiment.
"""

import itertools
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from rich.console import Console

from parking_exp.composition import Composed
from parking_exp.config import RunConfig
from parking_exp.errors import ConfigError, FailedRunError, OutputDirectoryError
from parking_exp.launching import Launch
from parking_exp.machine import cores
from parking_exp.monitor import Monitor
from parking_exp.runs import RunDirectory
from parking_exp.states import RunState, counts, find, read_state
from parking_exp.syncing import sync_all
from parking_exp.tables import cell_table, duration, failure_lines
from parking_exp.tracking import LATER
from parking_exp.validation import validate
from parking_exp.wording import closest

RETRY = ("failed",)


@dataclass(frozen=True)
class Planned:
    """One run of a sweep, and how far it was when the sweep began.

    Attributes:
        config: of the run.
        path: its directory.
        label: of its cell.
        state: how far it is.
        retried: whether it is run again if it has failed.
    """

    config: RunConfig
    path: Path
    label: str
    state: RunState
    retried: bool

    @property
    def is_due(self) -> bool:
        """Whether this sweep runs it, unless another process does."""
        if self.state.stage == "failed":
            return self.state.killed or self.retried
        return self.state.stage != "done"


def plan(composed: Sequence[Composed], retry: str | None = None) -> list[Planned]:
    """Check every run of a sweep, and look up how far it is.

    Raises:
        ConfigError: a run cannot be, or `retry` is neither None nor `failed`.
    """
    if retry is not None and retry not in RETRY:
        raise ConfigError(f"retry={retry} is not a valid choice{closest(str(retry), RETRY)}")
    runs: dict[Path, Planned] = {}
    cells: dict[int, tuple[RunConfig, Path]] = {}  # a cell is checked once for all its seeds
    for one in composed:
        if id(one.cell) not in cells:
            config = validate(one.cell)
            cells[id(one.cell)] = config, config.run_dir.parent
        config, folder = cells[id(one.cell)]
        if one.seed is not None:
            config = config.model_copy(update={"seed": one.seed})
        path = folder / f"seed={config.seed}"
        if path not in runs:
            runs[path] = Planned(config, path, one.label or folder.name, read_state(path), retry == "failed")
    return list(runs.values())


def sweep(runs: Sequence[Planned], launch: Launch, *, dry_run: bool = False) -> None:
    """Print the plan, do what is due, and print how it went.

    Raises:
        FailedRunError: not all runs are done at the end (or running elsewhere).
        InterruptedRunError: a signal stopped it.
    """
    out = Console(highlight=False, soft_wrap=True)
    describe(runs, launch.config, out)
    if dry_run:
        return
    if not any(run.is_due for run in runs):
        _judge([run.state for run in runs])
        return
    begin = time.time()
    try:
        due = [run.path for run in runs if run.is_due and _freeze(run)]
        with Monitor([run.path for run in runs]) as monitor:
            _launch_all(due, launch, begin, monitor)
            for directory, problem in sync_all(RunDirectory(run.path) for run in runs):  # of workers that were killed
                if problem:
                    monitor.say(f"{directory.path} is not all in its store ({problem}); {LATER}")
    finally:
        states = [read_state(run.path) for run in runs]
        out.print(cell_table(states))
        for line in failure_lines(states):
            out.print(line)
    _judge(states)


def describe(runs: Sequence[Planned], launcher: DictConfig, out: Console) -> None:
    """Print the plan: cells x seeds, what is done, what will run, and how long that may take."""
    states = [run.state for run in runs]
    out.print(cell_table(states, [run.label for run in runs]))
    found, due = counts(states), [run for run in runs if run.is_due and run.state.stage != "running"]
    cells, seeds = len({run.path.parent for run in runs}), len({run.config.seed for run in runs})
    left = found["failed"] - sum(run.state.stage == "failed" for run in due)
    parts = [f"{found['done']} done", f"{found['running']} running elsewhere" if found["running"] else ""]
    parts += [f"{left} failed before (retry=failed runs them again)" if left else "", f"{len(due)} to run"]
    summary = f"{cells} cells x {seeds} seeds = {len(runs)} runs: {', '.join(filter(None, parts))}"
    out.print(summary + _estimate(runs, due, launcher))


def _estimate(runs: Sequence[Planned], due: Sequence[Planned], launcher: DictConfig) -> str:
    """Say how long the due runs may take, from finished ones: of the same cell, the sweep, or the output directory."""
    if not due:
        return ""
    states = [run.state for run in runs if run.state.stage == "done"]
    if not states:
        here = runs[0].config
        states = [s for s in map(read_state, itertools.islice(find(here.output_path), 1000)) if s.stage == "done"]
    rates = [(s.cell, s.wall_s / s.step) for s in states if s.wall_s and s.step]
    if not rates:
        return "; no run has finished yet to tell the time by"
    overall = sum(rate for _, rate in rates) / len(rates)
    of_cell = {cell: [rate for name, rate in rates if name == cell] for cell, _ in rates}
    seconds = 0.0
    for run in due:
        known = of_cell.get(run.path.parent.name)
        rate = sum(known) / len(known) if known else overall
        seconds += rate * (run.config.total_timesteps - run.state.step)
    workers = _workers(launcher)
    shared = f" with {workers} at a time" if workers > 1 else ""
    return f", about {duration(seconds / max(1, min(workers, len(due))))}{shared}"


def _workers(launcher: DictConfig) -> int:
    """How many runs a launcher has under way at once, as far as its config says."""
    if "n_jobs" in launcher:
        return launcher.n_jobs or len(cores())
    return 1


def _freeze(run: Planned) -> bool:
    """Freeze a run's config, and say whether that could be done; the others go on without it."""
    try:
        RunDirectory(run.path).freeze(run.config, run.label, run.state.started)
    except (OutputDirectoryError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return False
    return True


def _launch_all(due: list[Path], launch: Launch, begin: float, monitor: Monitor) -> None:
    """Launch what is due, and again what another process had taken and did not finish."""
    before: list[Path] | None = None
    while due and due != before:
        if problem := launch(due):
            monitor.say(f"error: {problem}")
        before = due
        due = [path for path in due if _is_open(path, begin)]


def _is_open(path: Path, begin: float) -> bool:
    """Whether a run is to be done, nobody is at it, and this sweep has not tried."""
    state = read_state(path)
    return state.stage == "pending" and (state.started or 0.0) < begin


def _judge(states: Sequence[RunState]) -> None:
    """Raise FailedRunError unless every run is done, or under way elsewhere."""
    found: Any = counts(states)
    if not found["failed"] and not found["pending"]:
        return
    parts = [
        f"{found[stage]} {word}" for stage, word in (("failed", "failed"), ("pending", "not done")) if found[stage]
    ]
    advice = "; type the same command to go on" if found["pending"] or any(s.killed for s in states) else ""
    advice += (
        "; retry=failed runs failed ones again" if any(s.stage == "failed" and not s.killed for s in states) else ""
    )
    raise FailedRunError(f"of {len(states)} runs, {' and '.join(parts)}{advice}")

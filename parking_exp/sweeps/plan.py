"""The plan of a sweep: its runs, how far each is, which are due, and how long they may take."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from parking_exp.config.compose import Composed
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate
from parking_exp.errors import plural
from parking_exp.resources import cores
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.state import RunState, counts, read_state
from parking_exp.runs.state_tables import cell_table, damaged_lines, duration, version_lines
from parking_exp.sweeps.hydra_launcher import Launch

NO_RUN_YET = "; no run has finished yet to tell the time by"


@dataclass(frozen=True)
class PlannedRun:
    """One run of a sweep, and how far it was when the sweep began.

    Attributes:
        config: of the run.
        path: its directory.
        label: of its cell.
        state: how far it is.
        retried: whether it is run again if it has failed.
        lacks_models: whether it is done, and models of its are gone that can be made again.
        entries: what goes into its status.json besides.
    """

    config: RunConfig
    path: Path
    label: str
    state: RunState
    retried: bool
    lacks_models: bool
    entries: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_due(self) -> bool:
        """Whether this sweep runs it, unless another process does."""
        if self.state.stage == "failed":
            return self.state.killed or self.retried
        return self.state.stage != "done" or self.lacks_models


def plan(
    composed: Sequence[Composed],
    retry: str | None = None,
    entries: Callable[[Composed], Mapping[str, Any]] = lambda one: {},
) -> list[PlannedRun]:
    """Check every run of a sweep, and read its state; with `retry`, failed ones are due as well.

    `entries` gives what goes into the status.json of a run besides.

    Raises:
        ConfigError: a run cannot be.
        OutputDirectoryError: another version of this package has begun a run, and it is not done.
    """
    runs: dict[Path, PlannedRun] = {}
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
            label = _label(one, config) or folder.name
            state, directory = read_state(path), RunDirectory(path)
            if state.other_version and state.stage != "done":
                directory.check_version()
            runs[path] = PlannedRun(
                config, path, label, state, retry is not None, directory.can_make_models, entries(one)
            )
    return list(runs.values())


def _label(one: Composed, config: RunConfig) -> str:
    """Return a cell's label, with the final name of an option that other keys of the cell rename."""
    groups = ("env", "algorithm", "buffer")
    names = {one.cell[group]["name"]: getattr(config, group).name for group in groups}
    return ", ".join(names.get(part, part) for part in one.label.split(", "))


def describe(runs: Sequence[PlannedRun], launch: Launch, out: Console) -> None:
    """Print the plan: cells x seeds, what is done, what will run, and how long that may take."""
    states = [run.state for run in runs]
    out.print(cell_table(states, [run.label for run in runs]))
    for line in (*damaged_lines(states), *version_lines(states)):
        out.print(line)
    found, due = counts(states), [run for run in runs if run.is_due and run.state.stage != "running"]
    cells, seeds = len({run.path.parent for run in runs}), len({run.config.seed for run in runs})
    product = plural(cells, "cell")
    if cells * seeds == len(runs):
        product += f" x {plural(seeds, 'seed')}"
    left = found["failed"] - sum(run.state.stage == "failed" for run in due)
    modelless = sum(run.state.stage == "done" for run in due)
    parts = [f"{found['done'] - modelless} done", f"{found['running']} running elsewhere" if found["running"] else ""]
    parts += [f"{left} failed before (retry=failed runs them again)" if left else "", f"{len(due)} to run"]
    parts[-1] += f" ({modelless} of them only to make models again that are gone)" if modelless else ""
    out.print(f"{product} = {plural(len(runs), 'run')}: {', '.join(filter(None, parts))}{_estimate(runs, due, launch)}")


def _estimate(runs: Sequence[PlannedRun], due: Sequence[PlannedRun], launch: Launch) -> str:
    """Return in words how long the due runs may take.

    That is estimated from finished runs of the same cell, else of the sweep, else of the output directory.
    """
    if not due:
        return ""
    rates = _rates([run.state for run in runs]) or _rates_in(runs[0].config)
    if not rates:
        return NO_RUN_YET
    overall = sum(rate for _, rate in rates) / len(rates)
    of_cell = {cell: [rate for name, rate in rates if name == cell] for cell, _ in rates}
    seconds = 0.0
    for run in due:
        known = of_cell.get(run.path.parent.name)
        rate = sum(known) / len(known) if known else overall
        seconds += rate * (run.config.total_timesteps - run.state.step)
    if (workers := _workers(launch)) is None:
        return f", about {duration(seconds)} of work"
    shared = f" with {workers} at a time" if workers > 1 else ""
    return f", about {duration(seconds / min(workers, len(due)))}{shared}"


def duration_estimate(config: RunConfig, steps: int, workers: int) -> str:
    """Return in words how long so many env steps may take, from finished runs in the output directory."""
    if not steps:
        return ""
    rates = _rates_in(config)
    if not rates:
        return NO_RUN_YET
    return f", about {duration(steps * sum(rate for _, rate in rates) / len(rates) / workers)}"


def _rates(states: Iterable[RunState]) -> list[tuple[str, float]]:
    """Return cell and seconds an env step of each run that is done."""
    return [(s.cell, s.wall_s / s.step) for s in states if s.stage == "done" and s.wall_s and s.step]


def _rates_in(config: RunConfig) -> list[tuple[str, float]]:
    return _rates(map(read_state, itertools.islice(find_runs(config.output_path), 1000)))


def _workers(launch: Launch) -> int | None:
    """Return how many runs a launcher trains at once; None where its config does not say."""
    if launch.name == "basic":
        return 1
    if launch.name == "local":
        return launch.config.n_jobs or len(cores())
    return launch.config.get("n_jobs")

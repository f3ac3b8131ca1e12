"""The plan of a sweep: its runs, how far each is, which are due, and how long they may take."""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

from rich.console import Console

from parking_exp.config.cell_labels import label_cells, settings_of
from parking_exp.config.compose import Composed
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate_all
from parking_exp.errors import ConfigError, plural
from parking_exp.resources import cores
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.run_state import RunState, by_cell, counts, read_state
from parking_exp.runs.state_tables import cell_table, damaged_lines, duration
from parking_exp.sweeps.hydra_launcher import Launch

NO_RUN_YET = "; no run has finished yet to tell the time by"
NO_RUN_OF_KIND_YET = "; no run of its kind has finished yet to tell the time by"
# Files that an estimate reads at most; a config takes some 10 ms.
MOST_STATES, MOST_CONFIGS = 1000, 100


@dataclass(frozen=True)
class PlannedRun:
    """One run of a sweep, and how far it was when the sweep began.

    Attributes:
        config: of the run.
        path: its directory.
        label: of its cell.
        state: how far it is.
        retried: whether it is run again if it has failed.
        entries: what goes into its status.json besides.
    """

    config: RunConfig
    path: Path
    label: str
    state: RunState
    retried: bool
    entries: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_due(self) -> bool:
        """Whether this sweep runs it, unless another process does."""
        if self.state.stage == "failed":
            return self.state.killed or self.retried
        return self.state.stage != "done"


def plan(
    composed: Sequence[Composed],
    retry: str | None = None,
    entries: Callable[[Composed], Mapping[str, Any]] = lambda one: {},
) -> list[PlannedRun]:
    """Check every run of a sweep, and read its state; with `retry`, failed ones are due as well.

    `entries` gives what goes into the status.json of a run besides.

    Raises:
        ConfigError: a run cannot be.
    """
    runs: dict[Path, PlannedRun] = {}
    unique = {id(one.cell): one.cell for one in composed}  # a cell is checked once for all its seeds
    configs = validate_all(unique.values())
    cells = {key: (config, config.run_dir.parent) for key, config in zip(unique, configs, strict=True)}
    labels = _labels({folder: config for config, folder in cells.values()})
    for one in composed:
        config, folder = cells[id(one.cell)]
        if one.seed is not None:
            config = config.model_copy(update={"seed": one.seed})
        path = folder / f"seed={config.seed}"
        if path not in runs:
            label = one.label or labels[folder]
            runs[path] = PlannedRun(config, path, label, read_state(path), retry is not None, entries(one))
    return list(runs.values())


def _labels(cells: Mapping[Path, RunConfig]) -> dict[Path, str]:
    """Return what sets each cell apart from the others of its experiment."""
    labels: dict[Path, str] = {}
    for experiment in {folder.parent for folder in cells}:
        own = [folder for folder in cells if folder.parent == experiment]
        configs = [settings_of(cells[folder].plain()) for folder in own]
        labels |= zip(own, label_cells(configs, [folder.name for folder in own]), strict=True)
    return labels


def describe(runs: Sequence[PlannedRun], launch: Launch, out: Console) -> None:
    """Print the plan: cells x seeds, what is done, what will run, and how long that may take."""
    states = [run.state for run in runs]
    out.print(cell_table(states, [run.label for run in runs]))
    for line in damaged_lines(states):
        out.print(line)
    found, due = counts(states), [run for run in runs if run.is_due and run.state.stage != "running"]
    cells, seeds = len({run.path.parent for run in runs}), len({run.config.seed for run in runs})
    product = plural(cells, "cell")
    if cells * seeds == len(runs):
        product += f" x {plural(seeds, 'seed')}"
    left = found["failed"] - sum(run.state.stage == "failed" for run in due)
    parts = [f"{found['done']} done", f"{found['running']} running elsewhere" if found["running"] else ""]
    parts += [f"{left} failed before (retry=failed runs them again)" if left else "", f"{len(due)} to run"]
    out.print(f"{product} = {plural(len(runs), 'run')}: {', '.join(filter(None, parts))}{_estimate(runs, due, launch)}")


def _estimate(runs: Sequence[PlannedRun], due: Sequence[PlannedRun], launch: Launch) -> str:
    """Return in words how long the due runs may take.

    Each is timed by finished runs of its cell, else of its kind in the sweep, else of its kind in the output directory.
    """
    if not due:
        return ""
    kinds = {run.state.cell: _kind(run.config) for run in runs}
    rates: dict[str, float] = {}  # by cell, and by kind
    for state, rate in _cell_rates(run.state for run in runs):
        rates[state.cell] = rate
        rates.setdefault(kinds[state.cell], rate)
    if unknown := {kinds[run.state.cell] for run in due} - rates.keys():
        rates = _kind_rates(due[0].config.output_path, unknown) | rates
    timed = [(run, r) for run in due if (r := rates.get(run.state.cell) or rates.get(kinds[run.state.cell]))]
    if not timed:
        return NO_RUN_OF_KIND_YET if rates else NO_RUN_YET
    seconds = sum(rate * (run.config.total_timesteps - run.state.step) for run, rate in timed)
    rest = ""
    if len(timed) < len(due):
        rest = f" for {len(timed)} of them; of the others no run of their kind has finished yet"
    if (workers := _workers(launch)) is None:
        return f", about {duration(seconds)} of work{rest}"
    shared = f" with {workers} at a time" if workers > 1 else ""
    return f", about {duration(seconds / min(workers, len(timed)))}{shared}{rest}"


def duration_estimate(config: RunConfig, steps: int, workers: int) -> str:
    """Return in words how long so many env steps may take, by finished runs of the config's kind.

    Trials of a search are taken to do as much work as the config that they start from.
    """
    if not steps:
        return ""
    kind = _kind(config)
    rates = _kind_rates(config.output_path, {kind})
    if kind not in rates:
        return NO_RUN_OF_KIND_YET if rates else NO_RUN_YET
    return f", about {duration(steps * rates[kind] / workers)}"


def _kind(config: RunConfig) -> str:
    """Return what the work of an env step depends on: runs that agree in it take about as long for one."""
    # These change the time by orders of magnitude; features and tasks by less than half (docs/results.md).
    algorithm = config.algorithm
    update = algorithm.target, algorithm.net_arch, algorithm.arguments.get("batch_size")
    return repr((config.env.simulator, config.n_envs, config.update_rounds(), *update, config.device))


def _cell_rates(states: Iterable[RunState]) -> Iterator[tuple[RunState, float]]:
    """Yield a finished run of each cell and the cell's seconds an env step.

    Cells with the longest runs come first: in short runs, start-up and final evaluation take most of the time.
    """
    finished = [state for state in states if state.stage == "done" and state.wall_s and state.step]
    for _, cell in by_cell(sorted(finished, key=attrgetter("step"), reverse=True)):
        yield cell[0], sum(state.wall_s or 0 for state in cell) / sum(state.step for state in cell)


def _kind_rates(output_dir: Path, wanted: Set[str]) -> dict[str, float]:
    """Return seconds an env step of kinds with finished runs: of those that are wanted, and of others on the way."""
    rates: dict[str, float] = {}
    states = map(read_state, itertools.islice(find_runs(output_dir), MOST_STATES))
    for state, rate in itertools.islice(_cell_rates(states), MOST_CONFIGS):
        if wanted <= rates.keys():
            break
        with suppress(ConfigError):  # damaged, or it does not fit the schema
            rates.setdefault(_kind(RunDirectory(Path(state.run_dir)).config()), rate)
    return rates


def _workers(launch: Launch) -> int | None:
    """Return how many runs a launcher trains at once; None where its config does not say."""
    if launch.name == "basic":
        return 1
    if launch.name == "local":
        return launch.config.n_jobs or len(cores())
    return launch.config.get("n_jobs")

"""A sweep: what there is to do is planned, frozen, launched, watched, and summed up.

All that is known lies in the run directories, so that a sweep can be typed again in whatever state it was left, and
several can share one experiment.
"""

import fcntl
import itertools
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from parking_exp.config.compose import Composed
from parking_exp.config.paths import store_uri
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate
from parking_exp.errors import FailedRunError, OutputDirectoryError, plural
from parking_exp.resources import cores
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.state import RunState, Stage, counts, find, read_state
from parking_exp.runs.tables import cell_table, damaged_lines, duration, failure_lines, stopped_lines
from parking_exp.sweeps.launching import Launch
from parking_exp.sweeps.monitor import Monitor
from parking_exp.terminal import console, say
from parking_exp.tracking.outdated import sync_all
from parking_exp.tracking.tracker import later

WAIT_POLL_S = 1.0
SWEEPING = ".sweeping"  # in an experiment's folder: locked, shared, by every sweep that is at it


@dataclass(frozen=True)
class Planned:
    """One run of a sweep, and how far it was when the sweep began.

    Attributes:
        config: of the run.
        path: its directory.
        label: of its cell.
        state: how far it is.
        retried: whether it is run again if it has failed.
        lacks_models: whether it is done, and models of its are gone that can be made again.
    """

    config: RunConfig
    path: Path
    label: str
    state: RunState
    retried: bool
    lacks_models: bool

    @property
    def is_due(self) -> bool:
        """Whether this sweep runs it, unless another process does."""
        if self.state.stage == "failed":
            return self.state.killed or self.retried
        return self.state.stage != "done" or self.lacks_models


def plan(composed: Sequence[Composed], retry: str | None = None) -> list[Planned]:
    """Check every run of a sweep, and look up how far it is; with `retry`, failed ones are due as well.

    Raises:
        ConfigError: a run cannot be.
    """
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
            label = _label(one, config) or folder.name
            state, lacks_models = read_state(path), RunDirectory(path).can_make_models
            runs[path] = Planned(config, path, label, state, retry is not None, lacks_models)
    return list(runs.values())


def _label(one: Composed, config: RunConfig) -> str:
    """Return a cell's label, in which an option is called what other keys have made of it."""
    groups = ("env", "algorithm", "buffer")
    names = {one.cell[group]["name"]: getattr(config, group).name for group in groups}
    return ", ".join(names.get(part, part) for part in one.label.split(", "))


def sweep(runs: Sequence[Planned], launch: Launch, *, dry_run: bool = False) -> None:
    """Print the plan, do what is due, and print how it went.

    Raises:
        FailedRunError: not all runs are done at the end.
        InterruptedRunError: a signal stopped it.
    """
    out = console()
    describe(runs, launch, out)
    if dry_run:
        return
    if not any(run.is_due for run in runs):
        for line in failure_lines([run.state for run in runs]):
            out.print(line)
        _judge([run.state for run in runs])
        return
    try:
        with _sweeping({run.path.parents[1] for run in runs}) as others:
            due = [run.path for run in runs if run.is_due and _freeze(run, keep=others)]
            with Monitor([run.path for run in runs]) as monitor:
                _launch_all(due, launch, monitor)
                _sync(runs, monitor)
    finally:
        states = [read_state(run.path) for run in runs]
        out.print(cell_table(states))
        for line in (*stopped_lines(states), *failure_lines(states)):
            out.print(line)
    _judge(states)


def describe(runs: Sequence[Planned], launch: Launch, out: Console) -> None:
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
    modelless = sum(run.state.stage == "done" for run in due)
    parts = [f"{found['done'] - modelless} done", f"{found['running']} running elsewhere" if found["running"] else ""]
    parts += [f"{left} failed before (retry=failed runs them again)" if left else "", f"{len(due)} to run"]
    parts[-1] += f" ({modelless} of them only to make models again that are gone)" if modelless else ""
    out.print(f"{product} = {plural(len(runs), 'run')}: {', '.join(filter(None, parts))}{_estimate(runs, due, launch)}")


def _estimate(runs: Sequence[Planned], due: Sequence[Planned], launch: Launch) -> str:
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
    if (workers := _workers(launch)) is None:
        return f", about {duration(seconds)} of work"
    shared = f" with {workers} at a time" if workers > 1 else ""
    return f", about {duration(seconds / min(workers, len(due)))}{shared}"


def _workers(launch: Launch) -> int | None:
    """How many runs a launcher has under way at once; None where its config does not say."""
    if launch.name == "basic":
        return 1
    if launch.name == "local":
        return launch.config.n_jobs or len(cores())
    return launch.config.get("n_jobs")


@contextmanager
def _sweeping(folders: Iterable[Path]) -> Iterator[bool]:
    """Be known as a sweep of some experiments, and say whether another one is at any of them and has frozen configs.

    Raises:
        OutputDirectoryError: an experiment's folder can't be made.
    """
    handles, others = [], False
    try:
        for folder in folders:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                handles.append((folder / SWEEPING).open("w"))
            except OSError as error:
                raise OutputDirectoryError(f"output_dir: {folder} cannot be made: {error.strerror}") from error
            try:
                fcntl.flock(handles[-1], fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                others = True
            fcntl.flock(handles[-1], fcntl.LOCK_SH)
        yield others
    finally:
        for handle in handles:
            handle.close()


def _freeze(run: Planned, keep: bool) -> bool:
    """Freeze a run's config, and say whether the run can be; the others go on without it."""
    try:
        RunDirectory(run.path).freeze(run.config, run.label, run.state.started, keep=keep)
    except (OutputDirectoryError, OSError) as error:
        say(f"error: {error}", stderr=True)
        return False
    return True


def _launch_all(due: list[Path], launch: Launch, monitor: Monitor) -> None:
    """Launch what is due, wait for what other sweeps have taken, and take over what they leave."""
    elsewhere = [path for path in due if read_state(path).stage == "running"]
    due = [path for path in due if path not in elsewhere]
    while due or elsewhere:
        if due:
            endings, problem = launch(due)
            if problem:
                monitor.say(f"error: {problem}")
            elsewhere += [path for path, ending in endings.items() if ending == "elsewhere"]
        due, elsewhere = _wait(elsewhere)


def _sync(runs: Sequence[Planned], monitor: Monitor) -> None:
    """Send what workers could not, because they were killed or their store was down."""
    uris = list({store_uri(run.config) for run in runs if run.config.tracking.mlflow})
    found = sync_all((RunDirectory(run.path) for run in runs), uris)
    problems = [(directory, problem) for directory, problem in found if problem]
    if problems:
        directory, problem = problems[0]
        whose = f"{len(problems)} runs are" if len(problems) > 1 else "a run is"
        what_to_do = later(directory.output_dir, directory.tracking_uri)
        monitor.say(f"{whose} not all in the store ({problem}); {what_to_do}")


def _wait(elsewhere: list[Path]) -> tuple[list[Path], list[Path]]:
    """Wait until a run that another sweep had under way is left by it; return those, and those that it still has."""
    while elsewhere:
        stages = {path: read_state(path).stage for path in elsewhere}
        elsewhere = [path for path, stage in stages.items() if stage == "running"]
        if left := [path for path, stage in stages.items() if stage == "pending"]:
            return left, elsewhere
        time.sleep(WAIT_POLL_S)
    return [], []


def _judge(states: Sequence[RunState]) -> None:
    """Raise FailedRunError unless every run is done."""
    found = counts(states)
    if found["done"] == len(states):
        return
    words: dict[Stage, str] = {"failed": "failed", "pending": "not done", "running": "still under way"}
    parts = [f"{found[stage]} {word}" for stage, word in words.items() if found[stage]]
    again = found["pending"] or any(state.killed for state in states)
    retry = any(state.stage == "failed" and not state.killed for state in states)
    advice = "; type the same command to go on" if again else ""
    advice += "; retry=failed runs failed ones again" if retry else ""
    raise FailedRunError(f"of {plural(len(states), 'run')}, {' and '.join(parts)}{advice}")

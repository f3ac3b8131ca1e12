"""Run a sweep: print its plan, freeze configs, launch what is due, watch it, sync the store, sum up.

All that is known lies in the run directories, so that a sweep can be typed again in whatever state it was left, and
several can share one experiment.
"""

import fcntl
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from parking_exp.config.paths import store_uri
from parking_exp.errors import FailedRunError, OutputDirectoryError, plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.state import RunState, Stage, counts, read_state
from parking_exp.runs.state_tables import cell_table, failure_lines, stopped_lines
from parking_exp.sweeps.hydra_launcher import Launch
from parking_exp.sweeps.monitor import Monitor
from parking_exp.sweeps.plan import PlannedRun, describe
from parking_exp.terminal import console, say
from parking_exp.tracking.sync_all import sync_problem

WAIT_POLL_S = 1.0
SWEEP_LOCK = ".sweeping"  # in an experiment's folder, held by every sweep of it: shared, so that they see each other


def sweep(runs: Sequence[PlannedRun], launch: Launch, *, dry_run: bool = False) -> None:
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
        with _registered({run.path.parents[1] for run in runs}) as others:
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


@contextmanager
def _registered(folders: Iterable[Path]) -> Iterator[bool]:
    """Hold the sweep locks of some experiments; yield whether another sweep holds one, and so has frozen configs.

    Raises:
        OutputDirectoryError: an experiment's folder can't be made.
    """
    handles, others = [], False
    try:
        for folder in folders:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                handles.append((folder / SWEEP_LOCK).open("w"))
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


def _freeze(run: PlannedRun, keep: bool) -> bool:
    """Freeze a run's config, and return whether that was possible; the others go on without it."""
    try:
        RunDirectory(run.path).freeze(run.config, run.label, run.state.started, keep=keep, entries=run.entries)
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
            results, problem = launch(due)
            if problem:
                monitor.say(f"error: {problem}")
            elsewhere += [path for path, result in results.items() if result == "elsewhere"]
        due, elsewhere = _wait(elsewhere)


def _sync(runs: Sequence[PlannedRun], monitor: Monitor) -> None:
    """Send what workers could not, because they were killed or their store was down."""
    uris = list({store_uri(run.config) for run in runs if run.config.tracking.mlflow})
    if problem := sync_problem([RunDirectory(run.path) for run in runs], uris):
        monitor.say(problem)


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
    advice = "; rerun the same command to resume" if again else ""
    advice += "; retry=failed runs failed ones again" if retry else ""
    raise FailedRunError(f"of {plural(len(states), 'run')}, {' and '.join(parts)}{advice}")

"""Run a sweep: print its plan, freeze configs, launch what is due, watch it, sync the store, sum up.

All that is known is in the run directories: the same command resumes a sweep in whatever state it was left, and
several sweeps can share one experiment.
"""

import time
from collections.abc import Sequence
from pathlib import Path

from parking_exp.config.overrides import in_quotes
from parking_exp.config.paths import store_uri
from parking_exp.errors import FailedRunError, plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_state import RunState, Stage, counts, read_state
from parking_exp.runs.state_tables import cell_table, failure_lines, stopped_lines
from parking_exp.sweeps.hydra_launcher import Launch
from parking_exp.sweeps.monitor import Monitor
from parking_exp.sweeps.plan import PlannedRun, describe
from parking_exp.terminal import console
from parking_exp.tracking.mirror import mirror_problem
from parking_exp.tracking.store import Store

POLL_S = 1.0


def sweep(runs: Sequence[PlannedRun], launch: Launch, *, dry_run: bool = False) -> None:
    """Print the plan, run what is due, and print the results.

    Raises:
        FailedRunError: not all runs are done at the end.
        InterruptedRunError: a signal stopped it.
    """
    out, paths = console(), [run.path for run in runs]
    describe(runs, launch, out)
    if dry_run:
        return
    due = [run for run in runs if run.is_due]
    for run in due:
        RunDirectory(run.path).freeze(run.config, run.label, run.state.started, entries=run.entries)
    try:
        if due:
            with Monitor(lambda: paths, len(paths)) as monitor:
                _launch_all([run.path for run in due], launch, monitor)
                _sync(runs, monitor)
    finally:
        states = [read_state(path) for path in paths]
        if due:
            out.print(cell_table(states))
        for line in (*stopped_lines(states), *failure_lines(states)):
            out.print(line)
    _check_all_done(states)


def _launch_all(due: list[Path], launch: Launch, monitor: Monitor) -> None:
    """Launch what is due, wait for runs that other sweeps have taken, and resume those that they leave."""
    while due:
        free = [path for path in due if read_state(path).stage != "running"]
        if free:
            values, problem = launch.jobs([[f"run={in_quotes(str(path))}"] for path in free])
            results = dict(zip(free, values, strict=False))  # a launcher that broke returns nothing
            if problem:
                monitor.say(f"error: {problem}")
            due = [path for path in due if path not in free or results.get(path) == "elsewhere"]
        else:
            time.sleep(POLL_S)
        due = [path for path in due if read_state(path).stage in ("running", "pending")]


def _sync(runs: Sequence[PlannedRun], monitor: Monitor) -> None:
    """Send to the store what workers could not, because they were killed or the store was down."""
    for uri in {store_uri(run.config) for run in runs if run.config.tracking.mlflow}:
        if problem := mirror_problem([RunDirectory(run.path) for run in runs], Store(uri, runs[0].config.output_path)):
            monitor.say(problem)


def _check_all_done(states: Sequence[RunState]) -> None:
    """Check that every run is done.

    Raises:
        FailedRunError: some are not.
    """
    by_stage = counts(states)
    if by_stage["done"] == len(states):
        return
    words: dict[Stage, str] = {"failed": "failed", "pending": "not done", "running": "still running"}
    parts = [f"{by_stage[stage]} {word}" for stage, word in words.items() if by_stage[stage]]
    resumable = by_stage["pending"] or any(state.killed for state in states)
    retry = any(state.stage == "failed" and not state.killed for state in states)
    advice = "; rerun the same command to resume" if resumable else ""
    advice += "; retry=failed runs failed ones again" if retry else ""
    raise FailedRunError(f"of {plural(len(states), 'run')}, {' and '.join(parts)}{advice}")

"""Work on a search: claim trials, train each on its seeds, prune, and record the objective.

The objective of a run is the normalised area under its success curve, 0 ... 1. The objective of a
trial is the mean of its runs.
"""

import errno
import os
import time
from statistics import mean
from typing import TYPE_CHECKING

from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, OutputDirectoryError, ResultsError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import METRICS_FILE, read_metrics
from parking_exp.runs.run_plans import write_plan
from parking_exp.runs.run_state import RunState, read_state
from parking_exp.statistics import normalised_area
from parking_exp.sweeps.local import Train
from parking_exp.tuning.search import Search
from parking_exp.tuning.study import REASON, RUNS, SEED_VALUES, changes_of, claim

if TYPE_CHECKING:
    from optuna import Study, Trial

ATTEMPTS = 3  # at a run whose process is killed, or that finds the disk full
DISK_FULL = os.strerror(errno.ENOSPC)
POLL_S = 0.5


def run_trials(search: Search, train: Train) -> None:
    """Train trials until none is left, or until `train` returns that it was stopped."""
    from optuna.pruners import MedianPruner, NopPruner

    opened = search.open()
    settings = search.request.search
    opened.study.pruner = MedianPruner() if settings.pruner else NopPruner()
    while (claimed := claim(opened, settings, search.request.n_trials)) is not None:
        trial, lock = claimed
        try:
            if not _train_trial(search, opened.study, trial, train):
                return
        finally:
            lock.release()


def _train_trial(search: Search, study: "Study", trial: "Trial", train: Train) -> bool:
    """Train a claimed trial on each seed, and record how it ended; return whether it has ended."""
    from optuna.trial import TrialState

    def fail(reason: str) -> bool:
        trial.set_user_attr(REASON, reason)
        study.tell(trial, state=TrialState.FAIL)
        return True

    settings = search.request.search
    try:
        config = search.config(changes_of(trial, settings.space))
    except ConfigError as error:  # an invalid combination of values
        return fail(str(error).replace("\n", "; "))

    entries = {"search": search.folder.name, "trial": trial.number}
    reported = study.trials[trial.number].intermediate_values  # by an earlier process
    values: list[float] = []
    runs: list[str] = []
    for seed in settings.tuning_seeds:
        run = config.model_copy(update={"seed": seed})
        runs.append(str(run.run_dir.relative_to(run.output_path)))
        trial.set_user_attr(RUNS, runs)
        state = _train_run(run, entries, train)
        if state is None:
            return False
        if state.stage != "done":
            return fail(f"seed {seed}: {state.reason or 'it failed'}")

        values.append(success_auc(RunDirectory(run.run_dir)))
        if len(values) not in reported:
            trial.report(mean(values), len(values))
        is_last = len(values) == len(settings.tuning_seeds)
        if trial.number > 0 and not is_last and trial.should_prune():
            study.tell(trial, state=TrialState.PRUNED)
            return True
    trial.set_user_attr(SEED_VALUES, values)
    study.tell(trial, mean(values))
    return True


def _train_run(config: RunConfig, entries: dict[str, object], train: Train) -> RunState | None:
    """Train a run until it is over, and return its state; None if it was stopped.

    Raises:
        OutputDirectoryError: the disk is full; the trial stays open.
    """
    directory = RunDirectory(config.run_dir)
    state = read_state(directory.path)
    attempts = 0
    while _may_succeed(state) and attempts < ATTEMPTS:
        label = f"trial {entries['trial']}"
        write_plan(directory, config, label, state.started, **entries)
        result = train(directory.path)
        if result == "interrupted":
            return None
        if result == "elsewhere":  # another trial has the same config
            time.sleep(POLL_S)
        else:
            attempts += 1
        state = read_state(directory.path)
    if DISK_FULL in (state.reason or ""):
        raise OutputDirectoryError(f"trial {entries['trial']}: {state.reason}; {state.run_dir}")
    return state


def _may_succeed(state: RunState) -> bool:
    """Return whether a run is unfinished, or failed for a reason that may be temporary."""
    if state.stage == "failed":
        return state.killed or DISK_FULL in (state.reason or "")
    return state.stage != "done"


def success_auc(directory: RunDirectory) -> float:
    """Return the normalised area under a run's success curve, with its final evaluation.

    Raises:
        ResultsError: the files with its results were deleted.
    """
    rates = {}
    for record in read_metrics(directory.path / METRICS_FILE):
        if "eval/success_rate" in record["metrics"]:
            rates[record["step"]] = record["metrics"]["eval/success_rate"]
    result = directory.read_result()
    if result is not None and "final/success_rate" in result.metrics:
        rates[result.steps] = result.metrics["final/success_rate"]
    if not rates:
        raise ResultsError(
            f"{directory.path}: the finished run has no success rate left; delete the directory to "
            "train it again"
        )
    steps = sorted(rates)
    return normalised_area(steps, [rates[step] for step in steps])

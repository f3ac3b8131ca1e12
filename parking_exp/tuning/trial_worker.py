"""Work on a search: claim trials one after the other, train each on its seeds, prune, and record
the objective.

The objective of a run is the normalised area under its success curve, 0 ... 1; that of a trial is
the mean of its runs.
"""

import errno
import os
import time
from statistics import mean
from typing import TYPE_CHECKING

from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, OutputDirectoryError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import METRICS_FILE, read_metrics
from parking_exp.runs.run_state import RunState, read_state
from parking_exp.statistics import normalised_area
from parking_exp.sweeps.local import Train
from parking_exp.tuning.search import Search
from parking_exp.tuning.study import CHANGES, REASON, RUNS, SEED_VALUES, claim

if TYPE_CHECKING:
    from optuna import Study, Trial

ATTEMPTS = 3  # at a run whose process is killed, or that finds the disk full
DISK_FULL = os.strerror(errno.ENOSPC)
POLL_S = 0.5


def work(search: Search, train: Train) -> None:
    """Train the trials of a search until none is left, or until `train` returns that it was
    stopped.
    """
    from optuna.pruners import MedianPruner, NopPruner

    opened, settings = search.open(), search.request.search
    opened.study.pruner = MedianPruner(n_startup_trials=5) if settings.pruner else NopPruner()
    while (claimed := claim(opened, settings, search.request.n_trials)) is not None:
        trial, lock = claimed
        try:
            if not _train_trial(search, opened.study, trial, train):
                return
        finally:
            lock.release()


def _train_trial(search: Search, study: "Study", trial: "Trial", train: Train) -> bool:
    """Train a claimed trial on one seed after the other, and record how it ended; return whether it
    has ended.
    """
    from optuna.trial import TrialState

    def fail(reason: str) -> bool:
        trial.set_user_attr(REASON, reason)
        study.tell(trial, state=TrialState.FAIL)
        return True

    try:
        config = search.config(trial.user_attrs[CHANGES])
    except ConfigError as error:  # an invalid combination of values
        return fail(str(error).replace("\n", "; "))
    n_reported = len(
        study.get_trials(deepcopy=False)[trial.number].intermediate_values
    )  # by an earlier process
    seeds, values, runs = search.request.search.tuning_seeds, list[float](), list[str]()
    for seed in seeds:
        run = config.model_copy(update={"seed": seed})
        runs.append(str(run.run_dir.relative_to(run.output_path)))
        trial.set_user_attr(RUNS, runs)
        state = _train_run(run, {"search": search.folder.name, "trial": trial.number}, train)
        if state is None:
            return False
        if state.stage != "done":
            return fail(f"seed {seed}: {state.reason or 'it failed'}")
        values.append(success_auc(RunDirectory(run.run_dir)))
        if len(values) > n_reported:
            trial.report(mean(values), len(values))
        if trial.number > 0 and len(values) < len(seeds) and trial.should_prune():
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
    directory, attempts = RunDirectory(config.run_dir), 0
    while True:
        state = read_state(directory.path)
        may_succeed = state.killed or DISK_FULL in (state.reason or "")
        if state.stage == "done" or (
            state.stage == "failed" and (attempts == ATTEMPTS or not may_succeed)
        ):
            break
        directory.write_plan(config, f"trial {entries['trial']}", state.started, entries=entries)
        result = train(directory.path)
        if result == "stopped":
            return None
        if result == "elsewhere":  # another trial has the same config
            time.sleep(POLL_S)
        else:
            attempts += 1
    if DISK_FULL in (state.reason or ""):
        raise OutputDirectoryError(f"trial {entries['trial']}: {state.reason}; {state.run_dir}")
    return state


def success_auc(directory: RunDirectory) -> float:
    """Return the normalised area under the success curve of a finished run, its final evaluation
    included.
    """
    records, name = read_metrics(directory.path / METRICS_FILE), "eval/success_rate"
    rates = {
        record["step"]: record["metrics"][name] for record in records if name in record["metrics"]
    }
    result = directory.result()
    if result is not None and "final/success_rate" in result.metrics:
        rates[result.steps] = result.metrics["final/success_rate"]
    steps = sorted(rates)
    return normalised_area(steps, [rates[step] for step in steps])

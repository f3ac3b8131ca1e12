"""Run a search: print its plan, train its trials, retrain the best on fresh seeds, write the winner."""

import time
from typing import TYPE_CHECKING

from rich.console import Console

from parking_exp.config.overrides import in_quotes
from parking_exp.config.paths import store_uri
from parking_exp.errors import ConfigError, FailedRunError, plural
from parking_exp.resources import cores
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.sweeps.hydra_launcher import Launch, train_run
from parking_exp.sweeps.plan import duration_estimate
from parking_exp.terminal import console
from parking_exp.tracking.sync_all import sync_problem
from parking_exp.tuning.monitor import TrialMonitor
from parking_exp.tuning.retest import retest, write_winner
from parking_exp.tuning.search import Search, study_in
from parking_exp.tuning.tables import progress_lines, space_table, trial_table
from parking_exp.tuning.trial_worker import work_job
from parking_exp.tuning.trials import TrialRow, counts, rows

if TYPE_CHECKING:
    from omegaconf import DictConfig
    from optuna import Study

WAIT_POLL_S = 1.0
ENOUGH_SEEDS = 3


def tune(search: Search, launch: Launch, *, dry_run: bool = False) -> None:
    """Train the remaining trials of a search, retrain the best on fresh seeds, and write the winner.

    Raises:
        ConfigError: the space, the study or the launcher does not fit.
        OutputDirectoryError: the experiment's folder can't be made.
        StoreError: the storage of the study fails.
        FailedRunError: not all trials are over, or re-runs failed.
        InterruptedRunError: a signal stopped it.
    """
    search.check()
    out = console()
    n_trials, n_workers = search.request.n_trials, _n_workers(search, launch)
    if dry_run:
        found = study_in(search.folder, search.request.storage)
        _describe(search, found.trials[:n_trials] if found else [], n_workers, out)
        return
    study = search.open().study
    trials = rows(study, search.folder, n_trials)
    _describe(search, trials, n_workers, out)
    search.save()
    if _left(search, trials):
        trials = _train(search, study, launch, n_workers)
    out.print(trial_table(trials, search.request.search))
    for line in progress_lines(trials, search.request.search, n_trials):
        out.print(line)
    if left := _left(search, trials):
        raise FailedRunError(f"{plural(left, 'trial')} not over; rerun the same command to resume")
    if not counts(trials)["done"]:
        reason = next((trial.reason for trial in trials if trial.reason), "all were pruned")
        raise FailedRunError(f"no trial is done; the first reason: {reason}")
    write_winner(search, retest(search, trials, launch), out)


def _n_workers(search: Search, launch: Launch) -> int:
    """Return how many trials are trained at a time.

    Raises:
        ConfigError: neither the search nor the launcher sets it.
    """
    if search.request.n_workers:
        return search.request.n_workers
    if launch.name == "basic":
        return 1
    if n_jobs := launch.config.get("n_jobs"):
        return int(n_jobs)
    if launch.name == "local":
        return len(cores())
    raise ConfigError(f"hydra/launcher={launch.name}: set the number of parallel trials, n_workers=N")


def _left(search: Search, trials: list[TrialRow]) -> int:
    """Return how many trials are not over."""
    found = counts(trials)
    return search.request.n_trials - found["done"] - found["pruned"] - found["failed"]


def _describe(search: Search, trials: list[TrialRow], n_workers: int, out: Console) -> None:
    """Print the space, the budget, the progress, and an estimate of the time left."""
    request, base = search.request, search.base
    settings = request.search
    out.print(space_table(settings))
    what = " and ".join(settings.objective)
    enqueued = plural(len(settings.enqueue), "enqueued config")
    out.print(
        f"objective {what}; sampler {settings.sampler}, pruner {settings.pruner or 'none'}"
        + (f" after {settings.grace_updates:,} updates" if settings.pruner else "")
        + f"; trial 0 is the config as it stands{f', then {enqueued}' if settings.enqueue else ''}"
    )
    if len(settings.tuning_seeds) < ENOUGH_SEEDS:
        out.print(f"warning: seeds differ more than configs; fewer than {ENOUGH_SEEDS} tuning_seeds decide nothing")
    steps = len(settings.tuning_seeds) * base.total_timesteps
    left = _left(search, trials)
    retested = min(settings.n_retest + 1, request.n_trials) if settings.n_retest else 0
    fresh = retested * len(settings.test_seeds)
    estimate = duration_estimate(base, left * steps + fresh * base.total_timesteps, n_workers)
    out.print(
        f"{plural(request.n_trials, 'trial')} x {plural(len(settings.tuning_seeds), 'seed')} x "
        f"{base.total_timesteps:,} env steps at most, {plural(n_workers, 'trial')} at a time; at the end "
        f"{plural(fresh, 'run')} on fresh seeds: {request.n_trials - left} trials over, {left} to do{estimate}"
    )


def _train(search: Search, study: "Study", launch: Launch, n_workers: int) -> list[TrialRow]:
    """Launch workers while trials are left, wait for trials of other processes, and sync the store in the end."""
    n_trials = search.request.n_trials
    job = [f"study={in_quotes(str(search.folder))}", f"n_trials={n_trials}"]
    if search.request.storage:
        job.append(f"storage={in_quotes(search.request.storage)}")
    with TrialMonitor(search, search.open().study) as monitor:
        try:
            trials, problem = rows(study, search.folder, n_trials), None
            while _left(search, trials) and problem is None:
                running = counts(trials)["running"]
                if (free := _left(search, trials) - running) > 0:
                    _, problem = launch.jobs([job] * min(n_workers, free))
                    if problem:
                        monitor.say(f"error: {problem}")
                else:
                    time.sleep(WAIT_POLL_S)
                before, trials = trials, rows(study, search.folder, n_trials)
                if free > 0 and before == trials:  # the launcher did nothing
                    break
        finally:
            _sync(search, monitor)
    return trials


def _sync(search: Search, monitor: TrialMonitor) -> None:
    """Send what trials have not sent, because they were pruned, killed, or their store was down."""
    if not search.base.tracking.mlflow:
        return
    directories = [RunDirectory(path) for path in find_runs(search.base.output_path, search.base.experiment_name)]
    if problem := sync_problem(directories, [store_uri(search.base)]):
        monitor.say(problem)


def do_job(config: "DictConfig") -> object:
    """Hydra's task function: work on the search of a folder, or train the run of a directory."""
    if not config.study:
        return train_run(config)
    work_job(str(config.study), config.n_trials, config.storage)
    return None

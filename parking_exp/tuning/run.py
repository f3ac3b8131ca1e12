"""Run a search: print its plan, have workers train its trials, train the best on fresh seeds, write the winner down."""

import fcntl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

from parking_exp.config.overrides import in_quotes
from parking_exp.config.paths import store_uri
from parking_exp.errors import ConfigError, FailedRunError, OutputDirectoryError, plural
from parking_exp.resources import cores
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.sweeps.hydra_launcher import Launch, train_run
from parking_exp.sweeps.plan import duration_estimate
from parking_exp.terminal import console, say
from parking_exp.tracking.sync_all import sync_all
from parking_exp.tracking.tracker import later
from parking_exp.tuning.monitor import TrialMonitor
from parking_exp.tuning.retest import retest, write_winner
from parking_exp.tuning.search import Search, study_in
from parking_exp.tuning.study import storage_errors
from parking_exp.tuning.tables import progress_lines, space_table, trial_table
from parking_exp.tuning.trials import TrialRow, counts, rows
from parking_exp.tuning.unit_costs import shapes, unit_costs
from parking_exp.tuning.worker import work_job

if TYPE_CHECKING:
    from omegaconf import DictConfig
    from optuna import Study

WAIT_POLL_S = 1.0
ENOUGH_SEEDS = 3
TUNING_LOCK = ".tuning"  # in the experiment's folder, shared by all that work on the study from this machine


def tune(search: Search, launch: Launch, *, dry_run: bool = False) -> None:
    """Do the trials of a search that are left, re-run the best on fresh seeds, and write the winner as an experiment.

    Raises:
        ConfigError: the space, the study or the launcher does not fit.
        StoreError: the storage of the study fails.
        FailedRunError: not all trials are over, or re-runs failed.
        InterruptedRunError: a signal stopped it.
    """
    search.check()
    out = console()
    n_workers = _n_workers(search, launch)
    if dry_run:
        found = study_in(search.folder)
        _describe(search, _trials(search, found.study) if found else [], n_workers, out)
        return
    with _folder(search):
        study = search.open()
        trials = _trials(search, study)
        _describe(search, trials, n_workers, out)
        search.save()
        if _left(search, trials):
            if "cost_to_95" in search.request.search.objective:
                out.print("measuring the cost of an update and of an env step, once for each shape of networks")
                unit_costs(study, shapes(search.request.search, search.config))
            trials = _train(search, study, launch, n_workers)
        out.print(trial_table(trials, search.request.search))
        for line in progress_lines(trials, search.request.search, search.request.n_trials):
            out.print(line)
        if left := _left(search, trials):
            raise FailedRunError(f"{plural(left, 'trial')} not over; type the same command to go on")
        if not counts(trials)["done"]:
            reason = next((trial.reason for trial in trials if trial.reason), "all were pruned")
            raise FailedRunError(f"no trial is done; the first reason: {reason}")
        tested = retest(search, trials, launch)
        write_winner(search, tested, out)


def _n_workers(search: Search, launch: Launch) -> int:
    """Return how many trials are trained at a time.

    Raises:
        ConfigError: neither the search nor the launcher says.
    """
    if search.request.n_workers:
        return search.request.n_workers
    if launch.name == "basic":
        return 1
    if n_jobs := launch.config.get("n_jobs"):
        return int(n_jobs)
    if launch.name == "local":
        return len(cores())
    raise ConfigError(f"hydra/launcher={launch.name}: say how many trials are trained at a time, n_workers=N")


@contextmanager
def _folder(search: Search) -> Iterator[None]:
    """Make the experiment's folder, and hold its lock: several may, so that others can see that a search goes on.

    Raises:
        OutputDirectoryError: it can't be made.
    """
    try:
        search.folder.mkdir(parents=True, exist_ok=True)
        handle = (search.folder / TUNING_LOCK).open("w")
    except OSError as error:
        raise OutputDirectoryError(f"output_dir: {search.folder} cannot be made: {error.strerror}") from error
    with handle:
        fcntl.flock(handle, fcntl.LOCK_SH)
        yield


def _trials(search: Search, study: "Study") -> list[TrialRow]:
    with storage_errors(study.study_name):
        return rows(study, search.folder, search.request.n_trials)


def _left(search: Search, trials: list[TrialRow]) -> int:
    """Return how many trials are not over."""
    found = counts(trials)
    return search.request.n_trials - found["done"] - found["pruned"] - found["failed"]


def _describe(search: Search, trials: list[TrialRow], n_workers: int, out: Console) -> None:
    """Print the space, the budget, what is done, and how long the rest may take."""
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
    fresh = (settings.n_retest + 1) * len(settings.test_seeds) if settings.n_retest else 0
    estimate = duration_estimate(base, left * steps + fresh * base.total_timesteps, n_workers)
    out.print(
        f"{plural(request.n_trials, 'trial')} x {plural(len(settings.tuning_seeds), 'seed')} x "
        f"{base.total_timesteps:,} env steps at most, {plural(n_workers, 'trial')} at a time; at the end "
        f"{plural(fresh, 'run')} on fresh seeds: {request.n_trials - left} trials over, {left} to do{estimate}"
    )


def _train(search: Search, study: "Study", launch: Launch, n_workers: int) -> list[TrialRow]:
    """Launch workers as long as they find something to do, watch the trials, and sync the store in the end.

    What other processes have under way is waited for, and taken over where they leave it.
    """
    with TrialMonitor(search, search.open()) as monitor:
        try:
            trials, problem = _trials(search, study), None
            while _left(search, trials) and problem is None:
                running = counts(trials)["running"]
                if (free := _left(search, trials) - running) > 0:
                    _, problem = launch.jobs([f"study={in_quotes(str(search.folder))}"] * min(n_workers, free))
                    if problem:
                        monitor.console.print(f"error: {problem}")
                else:
                    time.sleep(WAIT_POLL_S)
                before, trials = trials, _trials(search, study)
                if free > 0 and before == trials:  # the launcher did nothing
                    break
        finally:
            _sync(search)
    return trials


def _sync(search: Search) -> None:
    """Send what trials have not sent, because they were pruned, killed, or their store was down."""
    if not search.base.tracking.mlflow:
        return
    directories = [RunDirectory(path) for path in find_runs(search.base.output_path, search.base.experiment_name)]
    problems = [(one, problem) for one, problem in sync_all(directories, [store_uri(search.base)]) if problem]
    if problems:
        directory, problem = problems[0]
        what_to_do = later(directory.output_dir, directory.tracking_uri)
        say(f"the store has not got all of {plural(len(problems), 'run')} ({problem}); {what_to_do}", stderr=True)


def do_job(config: "DictConfig") -> object:
    """Hydra's task function: work on the search of a folder, or train the run of a directory."""
    if not config.study:
        return train_run(config)
    work_job(str(config.study))
    return None

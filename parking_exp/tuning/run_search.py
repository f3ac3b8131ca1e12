"""Run a search: train its trials, retrain the best on test seeds, and write the winner."""

import itertools
import shlex
import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from statistics import mean
from typing import TYPE_CHECKING

import yaml
from rich.console import Console
from rich.table import Table

from parking_exp.config.cell_labels import GROUPS
from parking_exp.config.run_key import result_part
from parking_exp.errors import ConfigError, FailedRunError
from parking_exp.phrases import plural
from parking_exp.runs.atomic_files import write_atomically, write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.run_state import read_state
from parking_exp.sweeps.launchers import Launcher
from parking_exp.sweeps.local import LocalLauncher, run_workers
from parking_exp.sweeps.monitor import Monitor
from parking_exp.sweeps.sweep import PlannedRun, sweep
from parking_exp.terminal import command_of, make_console
from parking_exp.tracking.store_writer import StoreWriter
from parking_exp.tuning.search import Search, read_search
from parking_exp.tuning.trial_worker import run_trials, success_auc
from parking_exp.tuning.trials import (
    OBJECTIVE,
    RETEST_FILE,
    RetestedTrial,
    TrialRow,
    count_states,
    progress_lines,
    progress_table,
    rank_trials,
    read_trials,
)

if TYPE_CHECKING:
    from optuna import Study

POLL_S = 1.0


def run_search(search: Search, launcher: Launcher) -> None:
    """Train the remaining trials, retrain the best on test seeds, and write the winner."""
    if not isinstance(launcher, LocalLauncher):
        raise ConfigError(
            "a search trains on this machine; leave out hydra/launcher, and start it on several "
            "machines"
        )
    search.check()
    if search.base.init is not None:
        from parking_exp.training.warm_start import check_sources  # imports torch

        seeds = search.request.search.tuning_seeds
        check_sources(search.base.model_copy(update={"seed": seed}) for seed in seeds)
    out = make_console()
    request = search.request
    n_workers = request.n_workers or launcher.n_jobs
    stored = read_search(search.folder)
    trials = stored.trials[: request.n_trials] if stored else []
    _print_request(search, trials, n_workers, out)
    if request.dry_run:
        return

    study = search.open().study
    search.save()
    if _count_left(trials, request.n_trials):
        trials = _train_trials(search, study, n_workers)
    out.print(progress_table(trials), *progress_lines(trials, request.n_trials), sep="\n")
    if not rank_trials(trials):
        reasons = [trial.reason for trial in trials if trial.reason] or ["all were pruned"]
        raise FailedRunError(f"no trial is done; the first reason: {reasons[0]}")
    if request.search.n_retest:
        write_winner(search, _retest(search, trials, launcher), out)
    else:
        out.print("search.n_retest=0: no trial is retrained, and no experiment file is written")


def _count_left(trials: Sequence[TrialRow], n_trials: int) -> int:
    return n_trials - sum(trial.state in ("done", "pruned", "failed") for trial in trials)


def _print_request(
    search: Search, trials: Sequence[TrialRow], n_workers: int, out: Console
) -> None:
    """Print the space, the budget and the progress."""
    request = search.request
    settings = request.search
    for key, dimension in settings.space.items():
        out.print(f"{key}: {dimension}")
    out.print(f"sampler {settings.sampler}, pruner {settings.pruner or 'none'}")
    n_left = _count_left(trials, request.n_trials)
    out.print(
        f"{plural(request.n_trials, 'trial')} x {plural(len(settings.tuning_seeds), 'seed')} x "
        f"{search.base.total_timesteps:,} env steps at most, {plural(n_workers, 'trial')} at a "
        f"time: {plural(request.n_trials - n_left, 'trial')} over, {n_left} to do"
    )


def _train_trials(search: Search, study: "Study", n_workers: int) -> list[TrialRow]:
    """Train trials until none is left, wait for those of other processes, and sync the store."""
    base = search.base
    request = search.request
    names = {f"seed={seed}" for seed in request.search.tuning_seeds}

    def runs() -> list[Path]:
        paths = find_runs(base.output_path, base.experiment_name)
        return [path for path in paths if path.name in names]

    n_runs = request.n_trials * len(names)
    monitor = Monitor(runs, n_runs)
    with monitor, StoreWriter([base], monitor.say).syncing(runs):
        while True:
            trials = read_trials(study, search.folder, request.search.space, request.n_trials)
            n_left = _count_left(trials, request.n_trials)
            if not n_left:
                return trials
            n_free = n_left - count_states(trials)["running"]
            if n_free > 0:
                run_workers(partial(run_trials, search), min(n_workers, n_free))
            else:
                time.sleep(POLL_S)


def _retest(search: Search, trials: Sequence[TrialRow], launcher: Launcher) -> list[RetestedTrial]:
    """Train trial 0 and the best on the test seeds, as a sweep; store the results, best first."""
    request = search.request
    candidates = choose_trials(trials, request.search.n_retest)
    planned = []
    for seed, trial in itertools.product(request.search.test_seeds, candidates):
        config = search.config(trial.changes).model_copy(update={"seed": seed})
        path = config.run_dir
        entries = {"search": search.folder.name, "trial": trial.number}
        planned.append(
            PlannedRun(
                config=config,
                path=path,
                label=trial.label,
                state=read_state(path),
                retried=request.retry is not None,
                entries=entries,
            )
        )
    sweep(planned, launcher)

    retested = []
    for trial in candidates:
        paths = [run.path for run in planned if run.entries["trial"] == trial.number]
        test = [success_auc(RunDirectory(path)) for path in paths]
        retested.append(
            RetestedTrial(trial.number, trial.label, trial.changes, list(trial.by_seed), test)
        )
    retested.sort(key=lambda trial: (-mean(trial.test), trial.number))
    write_json(search.folder / RETEST_FILE, {"trials": [asdict(trial) for trial in retested]})
    return retested


def choose_trials(trials: Sequence[TrialRow], n_retest: int) -> list[TrialRow]:
    """Return trial 0, if it is done, and the best others; trials with the same runs count once."""
    distinct: dict[tuple[str, ...], TrialRow] = {}
    for trial in rank_trials(trials):
        distinct.setdefault(tuple(trial.runs), trial)
    unchanged = [trial for trial in distinct.values() if trial.number == 0]
    others = [trial for trial in distinct.values() if trial.number != 0]
    return unchanged + others[:n_retest]


def write_winner(search: Search, retested: Sequence[RetestedTrial], out: Console) -> None:
    """Print the results on test seeds, and write the best trial as an experiment file."""
    winner = retested[0]
    table = Table("trial", "tuning seeds", "test seeds", "difference", box=None, pad_edge=False)
    for trial in retested:
        tuning = mean(trial.tuning)
        test = mean(trial.test)
        difference = f"{100 * (tuning - test):+.1f} points"
        table.add_row(trial.label, f"{tuning:.1%}", f"{test:.1%}", difference)
    out.print(table)
    path = _write_experiment(search, winner, len(retested))
    seeds = plural(len(winner.test), "test seed")
    out.print(f"the winner is {winner.label}: {OBJECTIVE} {mean(winner.test):.1%} on {seeds}")
    out.print(f"experiment     {path}")
    command = [*command_of("train").split(), f"experiment={path}"]
    if search.extra_config_dir:
        command += ["--config-dir", search.extra_config_dir]
    out.print(f"train it with  {shlex.join(command)}")


def _write_experiment(search: Search, winner: RetestedTrial, n_retested: int) -> Path:
    """Write the experiment file of a trial's config, and return its path."""
    name = search.folder.name
    config = result_part(search.config(winner.changes).plain())
    del config["seed"]
    options = search.compose(winner.changes).options
    experiment = {
        "defaults": [{f"override /{group}": options[group]} for group in GROUPS],
        "experiment_name": f"tuned_{name}",
        **config,
    }
    head = (
        "# @package _global_\n"
        f"# Trial {winner.number} of search {name}, best of {n_retested} on test seeds.\n"
    )
    path = search.folder / f"tuned_{name}.yaml"
    write_atomically(path, head + yaml.safe_dump(experiment, sort_keys=False))
    return path

"""Run a search: print its plan, train its trials, retrain the best on test seeds, write the
winner.
"""

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

from parking_exp.config.run_key import result_part
from parking_exp.errors import ConfigError, FailedRunError, plural
from parking_exp.runs.atomic_files import write_atomically, write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.run_state import read_state
from parking_exp.sweeps.hydra_launcher import Launcher
from parking_exp.sweeps.local import LocalLauncher, run_workers
from parking_exp.sweeps.monitor import Monitor
from parking_exp.sweeps.store_writer import StoreWriter
from parking_exp.sweeps.sweep import PlannedRun, sweep
from parking_exp.terminal import console, program
from parking_exp.tuning.search import Search, study_in
from parking_exp.tuning.trial_worker import success_auc, work
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


def tune(search: Search, launcher: Launcher) -> None:
    """Train the remaining trials of a search, retrain the best on test seeds, and write the
    winner.
    """
    if not isinstance(launcher, LocalLauncher):
        raise ConfigError(
            "a search trains on this machine; leave out hydra/launcher, and start it on several "
            "machines"
        )
    search.check()
    out, request = console(), search.request
    n_trials, n_workers = request.n_trials, request.n_workers or launcher.n_jobs
    stored = study_in(search.folder)
    trials = stored.trials[:n_trials] if stored else []
    _describe(search, trials, n_workers, out)
    if request.dry_run:
        return
    study = search.open().study
    search.save()
    if _n_left(trials, n_trials):
        trials = _train(search, study, n_workers)
    out.print(progress_table(trials), *progress_lines(trials, n_trials), sep="\n")
    if not count_states(trials)["done"]:
        reason = next((trial.reason for trial in trials if trial.reason), "all were pruned")
        raise FailedRunError(f"no trial is done; the first reason: {reason}")
    if request.search.n_retest:
        write_winner(search, _retest(search, trials, launcher), out)
    else:
        out.print(
            "search.n_retest=0: no trial is trained on test seeds, and no experiment file is "
            "written"
        )


def _n_left(trials: Sequence[TrialRow], n_trials: int) -> int:
    """Return how many trials remain."""
    return n_trials - sum(trial.state in ("done", "pruned", "failed") for trial in trials)


def _describe(search: Search, trials: Sequence[TrialRow], n_workers: int, out: Console) -> None:
    """Print the space, the budget and the progress."""
    request, settings = search.request, search.request.search
    for key, dimension in settings.space.items():
        out.print(f"{key}: {dimension}")
    out.print(f"sampler {settings.sampler}, pruner {settings.pruner or 'none'}")
    left = _n_left(trials, request.n_trials)
    out.print(
        f"{plural(request.n_trials, 'trial')} x {plural(len(settings.tuning_seeds), 'seed')} x "
        f"{search.base.total_timesteps:,} env steps at most, {plural(n_workers, 'trial')} at a "
        "time: "
        f"{request.n_trials - left} trials over, {left} to do"
    )


def _train(search: Search, study: "Study", n_workers: int) -> list[TrialRow]:
    """Train while trials are left, wait for trials of other processes, and sync the store in the
    end.
    """
    base, n_trials = search.base, search.request.n_trials
    names = {f"seed={seed}" for seed in search.request.search.tuning_seeds}

    def runs() -> list[Path]:
        return [
            path for path in find_runs(base.output_path, base.experiment_name) if path.name in names
        ]

    with Monitor(runs, n_trials * len(names)) as monitor, StoreWriter(runs, [base], monitor.say):
        while left := _n_left(trials := read_trials(study, search.folder, n_trials), n_trials):
            if (free := left - count_states(trials)["running"]) > 0:
                run_workers(partial(work, search), min(n_workers, free))
            else:
                time.sleep(POLL_S)
    return trials


def _retest(search: Search, trials: Sequence[TrialRow], launcher: Launcher) -> list[RetestedTrial]:
    """Train trial 0 and the best trials on the test seeds, as a sweep, and store the results, best
    first.
    """
    request, planned = search.request, list[PlannedRun]()
    candidates = choose_trials(trials, request.search.n_retest)
    for seed, trial in itertools.product(request.search.test_seeds, candidates):
        config = search.config(trial.changes).model_copy(update={"seed": seed})
        entries = {"search": search.folder.name, "trial": trial.number}
        state = read_state(config.run_dir)
        planned.append(
            PlannedRun(
                config, config.run_dir, trial.label, state, request.retry is not None, entries
            )
        )
    sweep(planned, launcher)
    retested = []
    for trial in candidates:
        test = [
            success_auc(RunDirectory(run.path))
            for run in planned
            if run.entries["trial"] == trial.number
        ]
        retested.append(
            RetestedTrial(trial.number, trial.label, trial.changes, list(trial.by_seed), test)
        )
    retested.sort(key=lambda trial: (-mean(trial.test), trial.number))
    write_json(search.folder / RETEST_FILE, {"trials": [asdict(trial) for trial in retested]})
    return retested


def choose_trials(trials: Sequence[TrialRow], n_retest: int) -> list[TrialRow]:
    """Return trial 0, if it is done, and the best `n_retest` others, without trials that share the
    runs of another.
    """
    distinct = {tuple(trial.runs): trial for trial in reversed(rank_trials(trials))}
    best = rank_trials([*distinct.values()])
    return [
        *(trial for trial in best if trial.number == 0),
        *[trial for trial in best if trial.number != 0][:n_retest],
    ]


def write_winner(search: Search, retested: Sequence[RetestedTrial], out: Console) -> None:
    """Print the results on test seeds, and write the best trial as an experiment file."""
    winner, name = retested[0], search.folder.name
    table = Table("trial", "tuning seeds", "test seeds", "difference", box=None, pad_edge=False)
    for trial in retested:
        tuning, test = mean(trial.tuning), mean(trial.test)
        table.add_row(
            trial.label, f"{tuning:.1%}", f"{test:.1%}", f"{100 * (tuning - test):+.1f} points"
        )
    out.print(table)
    config = result_part(search.config(winner.changes).plain())
    del config["seed"]
    options = search.compose(winner.changes).options
    experiment = {
        "defaults": [
            {f"override /{group}": options[group]} for group in ("env", "algorithm", "buffer")
        ],
        "experiment_name": f"tuned_{name}",
        **config,
    }
    head = (
        f"# @package _global_\n# Trial {winner.number} of search {name}, best of {len(retested)} "
        "on test seeds.\n"
    )
    path = search.folder / f"tuned_{name}.yaml"
    write_atomically(path, head + yaml.safe_dump(experiment, sort_keys=False))
    seeds = plural(len(winner.test), "test seed")
    out.print(f"the winner is {winner.label}: {OBJECTIVE} {mean(winner.test):.1%} on {seeds}")
    out.print(f"experiment     {path}")
    config_dir = ["--config-dir", search.extra_config_dir] if search.extra_config_dir else []
    out.print(
        "train it with  "
        f"{shlex.join([*program('train').split(), f'experiment={path}', *config_dir])}"
    )

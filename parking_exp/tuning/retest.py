"""Retrain trial 0 and the best trials on test seeds, and write the winner as an experiment file."""

import itertools
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import mean
from typing import Annotated, Any

import yaml
from pydantic import Field, TypeAdapter
from rich.console import Console
from rich.table import Table

from parking_exp.config.run_key import result_part
from parking_exp.errors import plural
from parking_exp.runs.atomic_files import read_object, write_atomically, write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_state import read_state
from parking_exp.sweeps.hydra_launcher import Launch
from parking_exp.sweeps.plan import PlannedRun
from parking_exp.sweeps.sweep import sweep
from parking_exp.tuning.objectives import objective_value
from parking_exp.tuning.search import Search
from parking_exp.tuning.trials import TrialRow, ranked

RETEST_FILE = "retest.json"
Rates = Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=1)]


@dataclass(frozen=True)
class RetestedTrial:
    """A trial that was trained again on test seeds.

    Attributes:
        number, label, changes: of the trial.
        tuning, test: its objective on each tuning seed and on each test seed.
    """

    number: int
    label: str
    changes: Mapping[str, Any]
    tuning: Rates
    test: Rates


def retest(search: Search, trials: Sequence[TrialRow], launch: Launch) -> list[RetestedTrial]:
    """Train trial 0 and the best trials on the test seeds, as a sweep, and return the results, best first.

    Raises:
        FailedRunError: some of the runs failed.
    """
    request, settings, retested = search.request, search.request.search, []
    chosen = chosen_trials(trials, settings.n_retest)
    configs = {trial.number: search.config(trial.changes) for trial in chosen}
    planned: list[PlannedRun] = []
    for seed, trial in itertools.product(settings.test_seeds, chosen):
        config = configs[trial.number].model_copy(update={"seed": seed})
        entries = {"search": search.folder.name, "trial": trial.number}
        state = read_state(config.run_dir)
        planned.append(PlannedRun(config, config.run_dir, trial.label, state, request.retry is not None, entries))
    if not planned:
        return []
    sweep(planned, launch)
    for trial in chosen:
        directories = [RunDirectory(run.path) for run in planned if run.entries["trial"] == trial.number]
        test = [objective_value(directory, settings.objective) for directory in directories]
        retested.append(RetestedTrial(trial.number, trial.label, trial.changes, list(trial.by_seed), test))
    retested.sort(key=lambda trial: (-mean(trial.test), trial.number))
    seeds = {"tuning_seeds": settings.tuning_seeds, "test_seeds": settings.test_seeds}
    stored = {"objective": settings.objective, **seeds, "trials": [asdict(trial) for trial in retested]}
    write_json(search.folder / RETEST_FILE, stored)
    return retested


def read_retest(folder: Path) -> list[RetestedTrial]:
    """Return the trials that were trained again, best first; none before that.

    Raises:
        ValidationError: the file is damaged.
    """
    return TypeAdapter(list[RetestedTrial]).validate_python(read_object(folder / RETEST_FILE).get("trials", []))


def chosen_trials(trials: Sequence[TrialRow], n_retest: int) -> list[TrialRow]:
    """Return trial 0, if it is done, and the best `n_retest` others, without trials that share the runs of another."""
    if not n_retest:
        return []
    distinct: dict[tuple[str, ...], TrialRow] = {}
    for trial in ranked(trials):
        distinct.setdefault(tuple(trial.runs), trial)
    others = [trial for trial in distinct.values() if trial.number != 0]
    return [*(trial for trial in distinct.values() if trial.number == 0), *others[:n_retest]]


def write_winner(search: Search, retested: Sequence[RetestedTrial], out: Console) -> None:
    """Print the results on test seeds, and write the best trial as an experiment file."""
    if not retested:
        out.print("search.n_retest=0: no trial is trained on test seeds, and no experiment file is written")
        return
    winner, name = retested[0], search.folder.name
    table = Table("trial", "tuning seeds", "test seeds", "difference", box=None, pad_edge=False)
    for trial in retested:
        tuning, test = mean(trial.tuning), mean(trial.test)
        table.add_row(trial.label, f"{tuning:.1%}", f"{test:.1%}", f"{100 * (tuning - test):+.1f} points")
    out.print(table)
    config = result_part(search.config(winner.changes).plain())
    del config["seed"]
    options = search.compose(winner.changes).options
    experiment = {
        "defaults": [{f"override /{group}": options[group]} for group in ("env", "algorithm", "buffer")],
        "experiment_name": f"tuned_{name}",
        **config,
    }
    head = f"# @package _global_\n# Trial {winner.number} of search {name}, best of {len(retested)} on test seeds.\n"
    path = search.folder / f"tuned_{name}.yaml"
    write_atomically(path, head + yaml.safe_dump(experiment, sort_keys=False))
    seeds = plural(len(winner.test), "test seed")
    out.print(f"the winner is {winner.label}: {search.request.search.objective} {mean(winner.test):.1%} on {seeds}")
    out.print(f"experiment     {path}")
    config_dir = ["--config-dir", search.extra_config_dir] if search.extra_config_dir else []
    out.print(f"train it with  {shlex.join(['python', 'scripts/train.py', f'experiment={path}', *config_dir])}")

"""Retrain trial 0 and the best trials on fresh seeds, and write the winner as an experiment file."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import mean
from typing import Annotated, Any, cast

import yaml
from omegaconf import OmegaConf
from pydantic import Field, TypeAdapter
from rich.console import Console
from rich.table import Table

from parking_exp.config.compose import Composed, composed_runs
from parking_exp.config.overrides import in_quotes
from parking_exp.config.run_key import result_part
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate
from parking_exp.errors import FailedRunError, plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.files import read_object, write_atomically, write_json
from parking_exp.statistics.intervals import mean_interval
from parking_exp.sweeps.hydra_launcher import Launch
from parking_exp.sweeps.plan import plan
from parking_exp.sweeps.run import sweep
from parking_exp.tuning.objectives import read_curve, run_value
from parking_exp.tuning.schema import Objective, SearchConfig
from parking_exp.tuning.search import Search
from parking_exp.tuning.trials import TrialRow, ranked

RETEST_FILE = "retest.json"
Rates = Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=1)]
GROUPS = ("env", "algorithm", "buffer")


@dataclass(frozen=True)
class RetestedTrial:
    """A trial that was trained again on fresh seeds.

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
    settings = search.request.search
    chosen = _chosen(trials, settings)
    if not chosen:
        return []
    cells = {trial.number: search.composed_with(trial.changes).cell for trial in chosen}
    runs = [Composed(cells[trial.number], seed, trial.label) for seed in settings.test_seeds for trial in chosen]
    numbers = {id(cell): number for number, cell in cells.items()}

    def entries(run: Composed) -> dict[str, Any]:
        return {"search": search.folder.name, "trial": numbers[id(run.cell)]}

    sweep(plan(runs, search.composed.cell.retry, entries), launch)
    tested = [_retested(search, trial) for trial in chosen]
    tested.sort(key=lambda trial: (-mean(trial.test), trial.number))
    about = {"objective": settings.objective[0], "tuning_seeds": settings.tuning_seeds}
    found = [asdict(one) for one in tested]
    write_json(search.folder / RETEST_FILE, {**about, "test_seeds": settings.test_seeds, "trials": found})
    return tested


def read_retest(folder: Path) -> list[RetestedTrial]:
    """Return the trials that were trained again, best first; none before that.

    Raises:
        ValidationError: the file is damaged.
    """
    return TypeAdapter(list[RetestedTrial]).validate_python(read_object(folder / RETEST_FILE).get("trials", []))


def _chosen(trials: Sequence[TrialRow], settings: SearchConfig) -> list[TrialRow]:
    """Return trial 0, if it is done, and the best of the others, without trials that share the runs of another."""
    if not settings.n_retest:
        return []
    by_runs: dict[tuple[str, ...], TrialRow] = {}
    for trial in ranked(trials):
        by_runs.setdefault(tuple(trial.runs), trial)
    first = [trial for trial in by_runs.values() if trial.number == 0]
    others = [trial for trial in by_runs.values() if trial.number != 0]
    return [*first, *others[: settings.n_retest]]


def _retested(search: Search, trial: TrialRow) -> RetestedTrial:
    config, objective = search.config(trial.changes), search.request.search.objective[0]
    runs = [config.model_copy(update={"seed": seed}) for seed in search.request.search.test_seeds]
    test = [run_value(objective, read_curve(RunDirectory(run.run_dir))) for run in runs]
    return RetestedTrial(trial.number, trial.label, trial.changes, [values[0] for values in trial.by_seed], test)


def write_winner(search: Search, tested: Sequence[RetestedTrial], out: Console) -> None:
    """Print the results on fresh seeds, and write the best trial as an experiment file.

    Raises:
        FailedRunError: the file does not compose to the winner's config.
    """
    if not tested:
        out.print("nothing was trained on fresh seeds (search.n_retest=0), and no experiment file is written")
        return
    settings = search.request.search
    objective = settings.objective[0]
    out.print(retest_table(tested, objective))
    winner = tested[0]
    path = search.folder / f"tuned_{search.folder.name}.yaml"
    write_atomically(path, _as_experiment(search, winner, len(tested)))
    if search.config(winner.changes).cell_key != tuned_config(path, search.extra_config_dir).cell_key:
        raise FailedRunError(f"{path} does not compose to the config of trial {winner.number}; please report it")
    out.print(
        f"the winner is {winner.label}: {objective} {mean(winner.test):.1%} on "
        f"{plural(len(winner.test), 'fresh seed')}; tuning minus test {_drop(winner)}"
        + (f"; chosen as the best of {len(tested)}, its value is somewhat too high" if len(tested) > 1 else "")
    )
    out.print(f"experiment     {path}")
    config_dir = ["--config-dir", search.extra_config_dir] if search.extra_config_dir else []
    out.print(f"train it with  {shlex.join(['python', 'scripts/train.py', f'experiment={path}', *config_dir])}")


def retest_table(tested: Sequence[RetestedTrial], objective: Objective) -> Table:
    """Return one row for each retrained trial: its objective on tuning and on fresh seeds, and the difference."""
    table = Table(box=None, pad_edge=False)
    table.add_column("trial", overflow="fold")
    for title in (f"{objective}, tuning seeds", "fresh seeds", "tuning minus test"):
        table.add_column(title, justify="right")
    for one in tested:
        interval = ""
        if len(one.test) > 1:
            estimate = mean_interval(one.test)
            interval = f" [{100 * estimate.low:.1f}, {100 * estimate.high:.1f}]"
        table.add_row(
            one.label,
            f"{mean(one.tuning):.1%}",
            f"{mean(one.test):.1%}{interval}",
            _drop(one),
        )
    return table


def _drop(trial: RetestedTrial) -> str:
    return f"{100 * (mean(trial.tuning) - mean(trial.test)):+.1f} points"


def _as_experiment(search: Search, winner: RetestedTrial, n_tested: int) -> str:
    """Return the YAML of an experiment: the winner's groups, and the keys that differ from their defaults."""
    composed = search.composed_with(winner.changes)
    options = {group: composed.options[group] for group in GROUPS}
    plain = composed_runs("config", [f"{group}={option}" for group, option in options.items()], search.extra_config_dir)
    default = cast(dict[str, Any], OmegaConf.to_container(plain[0].cell, resolve=True))
    config = search.config(winner.changes).plain()
    del config["seed"]
    changed = _changed(result_part(config), result_part(default))
    of = f"of search {search.folder.name}, the best of {n_tested} on fresh seeds."
    head = ["# @package _global_", f"# Trial {winner.number} {of}"]
    content = {
        "defaults": [{f"override /{group}": option} for group, option in options.items()],
        "experiment_name": f"tuned_{search.folder.name}",
        **changed,
    }
    return "\n".join(head) + "\n" + yaml.safe_dump(content, sort_keys=False)


def _changed(config: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a config that its default lacks or gives another value."""
    changed = {}
    for key, value in config.items():
        usual = default.get(key)
        if key not in default or value != usual:
            changed[key] = _changed(value, usual) if isinstance(value, dict) and isinstance(usual, dict) else value
    return changed


def tuned_config(path: Path, extra_config_dir: str | None) -> RunConfig:
    """Return the config that an experiment file composes to."""
    return validate(composed_runs("config", [f"experiment={in_quotes(str(path))}"], extra_config_dir)[0].cell)

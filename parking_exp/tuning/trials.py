"""The trials of a search as validated rows, and the tables that show them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import Field, FiniteFloat, TypeAdapter
from rich.table import Table

from parking_exp.config.settings import display_setting
from parking_exp.phrases import plural
from parking_exp.runs.foreign_files import read_object
from parking_exp.runs.locks import is_held
from parking_exp.tuning.search_config import Dimension
from parking_exp.tuning.study import as_store_error, changes_of, trial_lock_path

if TYPE_CHECKING:
    from optuna import Study
    from optuna.trial import FrozenTrial

TrialState = Literal["done", "pruned", "failed", "running", "pending"]
STATES: Mapping[str, TrialState] = {"COMPLETE": "done", "PRUNED": "pruned", "FAIL": "failed"}
OBJECTIVE = "success_auc"  # in tables, and in files of reports
Rates = Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(min_length=1)]
RETEST_FILE = "retest.json"
MAX_SHOWN = 15


@dataclass(frozen=True)
class TrialRow:
    """A trial.

    Attributes:
        number: 0 is the unchanged config.
        state: `pending` again after its worker was killed.
        parameters: name -> a number or the text of a choice.
        value: mean of the objective over seeds; None unless it is done.
        runs: run directories, relative to the output directory.
    """

    number: int
    state: TrialState
    changes: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, int | FiniteFloat | str] = field(default_factory=dict)
    value: FiniteFloat | None = None
    by_seed: Sequence[FiniteFloat] = field(default_factory=list)
    runs: Sequence[str] = field(default_factory=list)
    reason: str | None = None

    @property
    def label(self) -> str:
        """Its number and what it changes."""
        changed = []
        for key, value in self.changes.items():
            group, _, name = key.rpartition(".")
            changed.append(f"{name}={display_setting(value)}" if group else display_setting(value))
        return f"trial {self.number}: {', '.join(changed) or 'unchanged'}"


@dataclass(frozen=True)
class RetestedTrial:
    """A trial that was trained again on test seeds.

    Attributes:
        tuning: objective on each tuning seed.
        test: objective on each test seed.
    """

    number: int
    label: str
    changes: Mapping[str, Any]
    tuning: Rates
    test: Rates


def read_trials(
    study: "Study", folder: Path, space: Mapping[str, Dimension], n_trials: int
) -> list[TrialRow]:
    """Return the trials in the study, at most the first `n_trials`.

    Raises:
        StoreError: a trial is damaged, or has choices that its search lacks.
    """
    with as_store_error(study.study_name):
        return [_read_trial(trial, folder, space) for trial in study.trials[:n_trials]]


def _read_trial(trial: "FrozenTrial", folder: Path, space: Mapping[str, Dimension]) -> TrialRow:
    state = STATES.get(trial.state.name, "pending")
    if state == "pending" and is_held(trial_lock_path(folder, trial.number)):
        state = "running"
    entries = {
        **trial.user_attrs,
        "number": trial.number,
        "state": state,
        "changes": changes_of(trial, space),
        "parameters": trial.params,
        # Optuna reports the last intermediate value of a pruned trial as its value.
        "value": trial.value if state == "done" else None,
    }
    return TypeAdapter(TrialRow).validate_python(entries)


def read_retest(folder: Path) -> list[RetestedTrial]:
    """Return the trials that were trained again, best first; none before that.

    Raises:
        ValidationError: the file is damaged.
    """
    return TypeAdapter(list[RetestedTrial]).validate_python(
        read_object(folder / RETEST_FILE).get("trials", [])
    )


def rank_trials(trials: Sequence[TrialRow]) -> list[TrialRow]:
    """Return the trials that are done, best first."""
    done = [trial for trial in trials if trial.value is not None]
    return sorted(done, key=lambda trial: trial.value or 0.0, reverse=True)


def count_states(trials: Sequence[TrialRow]) -> dict[str, int]:
    """Return how many trials are in each state."""
    states = [trial.state for trial in trials]
    return {state: states.count(state) for state in get_args(TrialState)}


def describe_states(trials: Sequence[TrialRow], n_trials: int) -> str:
    """Describe how many of `n_trials` are in each state, e.g. `2 done, 1 pruned`."""
    by_state = count_states(trials)
    by_state["pending"] += n_trials - len(trials)
    return ", ".join(f"{number} {state}" for state, number in by_state.items() if number)


def progress_table(trials: Sequence[TrialRow]) -> Table:
    """Return the best trials, then running and failed ones: state, value and changes."""
    table = Table("trial", "state", OBJECTIVE, "changes", box=None, pad_edge=False)
    others = [trial for trial in trials if trial.state in ("running", "failed")]
    for trial in [*rank_trials(trials)[:MAX_SHOWN], *others[:MAX_SHOWN]]:
        value = "" if trial.value is None else f"{trial.value:.1%}"
        changes = trial.label.partition(": ")[2]
        table.add_row(str(trial.number), trial.state, value, trial.reason or changes)
    return table


def progress_lines(trials: Sequence[TrialRow], n_trials: int) -> list[str]:
    """Return how many trials are in each state, and the best so far."""
    lines = [f"{plural(n_trials, 'trial')}: {describe_states(trials, n_trials)}"]
    ranked = rank_trials(trials)
    if ranked:
        best = ranked[0]
        lines.append(f"best so far: {best.label} ({OBJECTIVE} {best.value:.1%})")
    return lines

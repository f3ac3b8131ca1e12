"""The trials of a search as validated rows, their results on test seeds, and the tables that show
them.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import Field, FiniteFloat, TypeAdapter, ValidationError
from rich.table import Table

from parking_exp.config.cell_labels import setting
from parking_exp.errors import ConfigError, plural
from parking_exp.runs.atomic_files import read_object
from parking_exp.runs.directory import is_held
from parking_exp.tuning.search_config import Dimension
from parking_exp.tuning.study import study_errors, trial_lock_path

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
        changed = [
            f"{key.rpartition('.')[2]}={setting(value)}" if "." in key else setting(value)
            for key, value in self.changes.items()
        ]
        return f"trial {self.number}: {', '.join(changed) or 'unchanged'}"


@dataclass(frozen=True)
class RetestedTrial:
    """A trial that was trained again on test seeds, with its objective on each tuning seed and on
    each test seed.
    """

    number: int
    label: str
    changes: Mapping[str, Any]
    tuning: Rates
    test: Rates


def read_trials(study: "Study", folder: Path, n_trials: int) -> list[TrialRow]:
    """Return trial 0 and those that have begun, of the first `n_trials`."""
    with study_errors(study.study_name):
        trials = study.get_trials(deepcopy=False)[:n_trials]
    return [_row(trial, folder) for trial in trials]


def check_trials(trials: Sequence[TrialRow], space: Mapping[str, Dimension]) -> None:
    """Refuse trials with values that their search can't have sampled.

    Raises:
        ConfigError: with the first of them.
    """
    for trial in trials:
        outside = [
            key
            for key, value in trial.changes.items()
            if key not in space or not space[key].allows(value)
        ]
        outside += [
            key
            for key, value in trial.parameters.items()
            if not _is_parameter(space.get(key), value)
        ]
        if outside:
            raise ConfigError(
                f"the study is damaged: trial {trial.number} has {outside[0]} outside of "
                "search.space"
            )


def _is_parameter(dimension: Dimension | None, value: Any) -> bool:
    if dimension is None:
        return False
    if dimension.choices is not None:
        return value in [plain_choice(json.dumps(choice)) for choice in dimension.choices]
    return dimension.to_parameter(value) is not None


def _row(trial: "FrozenTrial", folder: Path) -> TrialRow:
    held = trial.state.name == "RUNNING" and is_held(trial_lock_path(folder, trial.number))
    # Optuna reports the last intermediate value of a pruned trial as its value.
    values = trial.values if trial.state.name == "COMPLETE" else None
    entries = {
        **trial.user_attrs,
        "number": trial.number,
        "state": STATES.get(trial.state.name, "running" if held else "pending"),
        "value": values[0] if values and len(values) == 1 else values,
    }
    try:
        parameters = {name: plain_choice(value) for name, value in trial.params.items()}
        return TypeAdapter(TrialRow).validate_python({**entries, "parameters": parameters})
    except ValueError as error:
        entry = error.errors()[0]["loc"][0] if isinstance(error, ValidationError) else "parameters"
        raise ConfigError(
            f"the study is damaged: trial {trial.number} has no valid {entry}"
        ) from error


def plain_choice(value: Any) -> float | str:
    """Return a readable parameter: Optuna stores choices as JSON."""
    if not isinstance(value, str):
        return value
    choice = json.loads(value)
    return (
        choice if isinstance(choice, str | int | float) and not isinstance(choice, bool) else value
    )


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
    return [
        trial
        for _, _, trial in sorted((-t.value, t.number, t) for t in trials if t.value is not None)
    ]


def count_states(trials: Sequence[TrialRow]) -> dict[TrialState, int]:
    """Return how many trials are in each state."""
    states = [trial.state for trial in trials]
    return {state: states.count(state) for state in get_args(TrialState)}


def progress_table(trials: Sequence[TrialRow]) -> Table:
    """Return the best trials, then running and failed ones: state, value and changes."""
    table = Table("trial", "state", OBJECTIVE, "changes", box=None, pad_edge=False)
    best, others = (
        rank_trials(trials),
        [trial for trial in trials if trial.state in ("running", "failed")],
    )
    for trial in [*best[: max(1, MAX_SHOWN - len(others))], *others[:MAX_SHOWN]]:
        value = "" if trial.value is None else f"{trial.value:.1%}"
        table.add_row(
            str(trial.number), trial.state, value, trial.reason or trial.label.partition(": ")[2]
        )
    return table


def progress_lines(trials: Sequence[TrialRow], n_trials: int) -> Iterator[str]:
    """Yield how many trials are in each state, and the best so far."""
    by_state = count_states(trials)
    by_state["pending"] += n_trials - len(trials)
    states = ", ".join(f"{number} {state}" for state, number in by_state.items() if number)
    yield f"{plural(n_trials, 'trial')}: {states}"
    for best in rank_trials(trials)[:1]:
        yield f"best so far: {best.label} ({OBJECTIVE} {best.value:.1%})"

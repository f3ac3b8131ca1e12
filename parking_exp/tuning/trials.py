"""The trials of a search as tables show them: state, parameters, values, and resources used."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import FiniteFloat, TypeAdapter, ValidationError

from parking_exp.errors import ConfigError
from parking_exp.runs.locks import is_held
from parking_exp.tuning.study import CHANGES, CPU_S, REASON, RUNS, SEED_VALUES, STEPS, storage_errors, trial_lock_path

if TYPE_CHECKING:
    from optuna import Study
    from optuna.trial import FrozenTrial

TrialState = Literal["done", "pruned", "failed", "running", "pending"]
STATES: tuple[TrialState, ...] = ("done", "pruned", "failed", "running", "pending")


@dataclass(frozen=True)
class TrialRow:
    """A trial.

    Attributes:
        number: 0 is the unchanged config.
        state: done, pruned, failed, running, or pending; pending again after its worker was killed.
        changes: what it changes in the search's config.
        parameters: name -> value, a number or the text of a choice.
        values: objectives, mean over seeds; empty unless it is done.
        by_seed: objectives of each seed.
        runs: run directories, relative to the output directory.
        env_steps, cpu_s: total of its runs; None if unknown.
        reason: why it failed.
        seconds: wall-clock duration; None before its end.
    """

    number: int
    state: TrialState
    changes: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, int | FiniteFloat | str] = field(default_factory=dict)
    values: Sequence[FiniteFloat] = ()
    by_seed: Sequence[Sequence[FiniteFloat]] = ()
    runs: Sequence[str] = ()
    env_steps: int | None = None
    cpu_s: FiniteFloat | None = None
    reason: str | None = None
    seconds: float | None = None

    @property
    def label(self) -> str:
        """Its number and what it changes."""
        changed = [
            f"{key.rpartition('.')[2]}={value}" if "." in key else str(value) for key, value in self.changes.items()
        ]
        return f"trial {self.number}: {', '.join(changed) or 'as it stands'}"


ROW = TypeAdapter(TrialRow)


def rows(study: "Study", folder: Path, n_trials: int) -> list[TrialRow]:
    """Return the trials that have begun or are enqueued, of the first `n_trials`.

    Raises:
        ConfigError: the study is damaged.
        StoreError: its storage fails.
    """
    with storage_errors(study.study_name):
        found, n_objectives = study.get_trials(deepcopy=False)[:n_trials], len(study.directions)
    return [_row(frozen, folder, n_objectives) for frozen in found]


def _row(frozen: "FrozenTrial", folder: Path, n_objectives: int) -> TrialRow:
    try:
        return ROW.validate_python(_entries(frozen, folder, n_objectives))
    except ValueError as error:
        what = error.errors()[0]["loc"][0] if isinstance(error, ValidationError) else "parameters"
        raise ConfigError(f"the study is damaged: trial {frozen.number} has no valid {what}") from error


def _entries(frozen: "FrozenTrial", folder: Path, n_objectives: int) -> dict[str, Any]:
    states = {"COMPLETE": "done", "PRUNED": "pruned", "FAIL": "failed", "WAITING": "pending"}
    attributes = frozen.user_attrs
    values = list(frozen.values or []) if frozen.state.name == "COMPLETE" else []
    return {
        "number": frozen.number,
        "state": states.get(frozen.state.name)
        or ("running" if is_held(trial_lock_path(folder, frozen.number)) else "pending"),
        "changes": attributes.get(CHANGES, {}),
        "parameters": {name: plain_choice(value) for name, value in frozen.params.items()},
        "values": values if len(values) in (0, n_objectives) else None,
        "by_seed": attributes.get(SEED_VALUES, []),
        "runs": attributes.get(RUNS, []),
        "env_steps": attributes.get(STEPS),
        "cpu_s": attributes.get(CPU_S),
        "reason": attributes.get(REASON),
        "seconds": frozen.duration.total_seconds() if frozen.duration else None,
    }


def plain_choice(value: Any) -> float | str:
    """Return a parameter as people read it: Optuna knows choices as JSON texts."""
    if not isinstance(value, str):
        return value
    choice = json.loads(value)
    return choice if isinstance(choice, str | int | float) and not isinstance(choice, bool) else value


def ranked(trials: Sequence[TrialRow]) -> list[TrialRow]:
    """Return the trials that are done, best first by the first objective."""
    return sorted((trial for trial in trials if trial.values), key=lambda trial: (-trial.values[0], trial.number))


def counts(trials: Sequence[TrialRow]) -> dict[TrialState, int]:
    """Return how many trials are in each state."""
    states = [trial.state for trial in trials]
    return {state: states.count(state) for state in STATES}

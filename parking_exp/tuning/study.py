"""The study of a search: Optuna's record of its trials, and which process works on which trial.

The study is a journal file in the experiment's folder, or is in the database of `storage`. A process holds a lock file
while it works on a trial; once that process has died, another one resumes the trial. Optuna's own heartbeat is for
`study.optimize` on databases only.
"""

import json
import os
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from filelock import FileLock

from parking_exp.config.paths import refuse_links
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, ParkingError, StoreError
from parking_exp.runs.directory import is_held
from parking_exp.tuning.search_config import SearchConfig

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.samplers import BaseSampler

STUDY_FILE, CLAIM_LOCK, TRIALS_FOLDER = "study.journal", ".claiming", ".trials"
Values = Callable[[Mapping[str, Any]], Mapping[str, Any]]
DEFINITION = "definition"  # attribute of a study
# Attributes of a trial.
CHANGES, RUNS, REASON, SEED_VALUES, STEPS, CPU_S = "changes", "runs", "reason", "by_seed", "env_steps", "cpu_s"


class OpenStudy(NamedTuple):
    """A study that trials are claimed from, its storage, and the folder of the search."""

    study: "Study"
    storage: Any
    folder: Path


class _JournalLock:
    """Lock of the journal, for Optuna; released by the system when its process dies."""

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, FileLock(f"{path}.lock")

    def acquire(self) -> bool:
        """Wait for the lock, and remove an incomplete last line, left by a kill or a full disk."""
        self._lock.acquire()
        with self._path.open("r+b") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 1))
            if file.read() not in (b"", b"\n"):
                file.seek(0)
                file.truncate(file.read().rfind(b"\n") + 1)
        return True

    def release(self) -> None:
        """Release the lock."""
        self._lock.release()


@contextmanager
def storage_errors(name: str) -> Iterator[None]:
    """Turn all other errors, which may come from any database driver, into a StoreError."""
    try:
        yield
    except ParkingError:
        raise
    except Exception as error:
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise StoreError(f"the study {name} can't be used: {line}") from error


def storage_of(folder: Path, uri: str | None) -> Any:
    """Return the storage of a study: the database at a URI, or without one the journal in the search's folder.

    Raises:
        UntrustedError: a file of the search is a symbolic link that leads out of its folder.
    """
    import optuna
    from optuna.storages.journal import JournalFileBackend, JournalStorage

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    path = folder / STUDY_FILE
    # Not all files of the folder: those of cells may be on another disk.
    refuse_links((file for names in (".*", "study.*", f"{TRIALS_FOLDER}/*") for file in folder.glob(names)), folder)
    with storage_errors(folder.name):
        folder.mkdir(parents=True, exist_ok=True)
        if uri is not None:
            return optuna.storages.get_storage(uri)
        path.touch()
        return JournalStorage(JournalFileBackend(str(path), lock_obj=cast(Any, _JournalLock(path))))


def open_study(folder: Path, search: SearchConfig, base: RunConfig, values: Values, storage: Any) -> OpenStudy:
    """Return the study of a search; create it, with trial 0 and the enqueued configs, if there is none.

    Args:
        folder: of the experiment.
        base: the config that trials change.
        values: changes -> value of each key of the space in the config with these changes.

    Raises:
        ConfigError: the study was made with another space, objective, seeds or base config.
    """
    import optuna

    name = folder.name
    with FileLock(folder / CLAIM_LOCK), storage_errors(name):
        study = optuna.create_study(storage=storage, study_name=name, direction="maximize", load_if_exists=True)
        definition = _definition(search, base)
        known = study.user_attrs.get(DEFINITION)
        if known is None:
            study.set_user_attr(DEFINITION, definition)
        elif differing := [key for key in {**known, **definition} if known.get(key) != definition.get(key)]:
            raise ConfigError(
                f"the study {name} was made with another {', '.join(differing)}; restore that to resume it, or start "
                "another study with experiment_name=OTHER"
            )
        for changes in [{}, *search.enqueue][len(study.get_trials(deepcopy=False)) :]:
            _enqueue(study, search, changes, values(changes))
    return OpenStudy(study, storage, folder)


def _definition(search: SearchConfig, base: RunConfig) -> dict[str, Any]:
    """Return what must not change for trials to be comparable: objective, seeds, space and base config."""
    plain = json.loads(search.model_dump_json(by_alias=True, exclude_none=True))
    definition = {f"search.{key}": plain[key] for key in ("objective", "tuning_seeds", "enqueue")}
    definition |= {f"search.space.{key}": value for key, value in plain["space"].items()}
    return definition | {"base config": base.model_copy(update={"seed": 0}).run_key}


def _enqueue(study: "Study", search: SearchConfig, changes: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    """Add a waiting trial, with the parameters that are inside the space, so that samplers know them."""
    from optuna.trial import FixedTrial, TrialState, create_trial

    parameters = {key: dimension.to_parameter(values[key]) for key, dimension in search.space.items()}
    parameters = {key: parameter for key, parameter in parameters.items() if parameter is not None}
    fixed = FixedTrial(parameters)
    for key in parameters:
        search.space[key].suggest(fixed, key)
    trial = create_trial(
        state=TrialState.WAITING, params=fixed.params, distributions=fixed.distributions, user_attrs={CHANGES: changes}
    )
    study.add_trial(trial)


def trial_lock_path(folder: Path, number: int) -> Path:
    """Return the path of a trial's lock file."""
    return folder / TRIALS_FOLDER / f"{number:05d}.lock"


def claim(opened: OpenStudy, search: SearchConfig, n_trials: int) -> "tuple[Trial, FileLock] | None":
    """Resume an abandoned trial or begin the next one; return it and the lock to release, or None if none is left."""
    import optuna

    study, folder = opened.study, opened.folder
    with FileLock(folder / CLAIM_LOCK):
        free = {t.number for t in study.get_trials(deepcopy=False) if not is_held(trial_lock_path(folder, t.number))}
        trials = study.get_trials(deepcopy=False)[:n_trials]  # after the locks: a trial may just have ended
        abandoned = [t.number for t in trials if t.state.name == "RUNNING" and t.number in free]
        waiting = [t.number for t in trials if t.state.name == "WAITING"]
        number = next(iter([*abandoned, *waiting]), len(trials))
        if number == n_trials:
            return None
        study.sampler = make_sampler(search, zlib.crc32(f"{study.study_name} {number}".encode()))
        if abandoned:
            study_id = opened.storage.get_study_id_from_name(study.study_name)
            trial = optuna.Trial(study, opened.storage.get_trial_id_from_study_id_trial_number(study_id, number))
        else:
            trial = study.ask()
        if CHANGES not in trial.user_attrs:
            space = search.space.items()
            changes = {key: dimension.to_value(dimension.suggest(trial, key)) for key, dimension in space}
            trial.set_user_attr(CHANGES, changes)
        path = trial_lock_path(folder, trial.number)
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, thread_local=False)
        lock.acquire()
    return trial, lock


def make_sampler(search: SearchConfig, seed: int) -> "BaseSampler":
    """Return the sampler of a search; each trial has a seed of its own, so that a restart repeats none."""
    from optuna import samplers
    from optuna.exceptions import ExperimentalWarning

    if search.sampler == "random":
        return samplers.RandomSampler(seed=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        # `group`: enqueued trials may lack parameters.
        return samplers.TPESampler(multivariate=True, group=True, constant_liar=True, seed=seed)

"""The study of a search: Optuna's record of its trials, and which process works on which trial.

The study is a journal file in the experiment's folder. A process holds a lock file while it works
on a trial; once that process has died, another one resumes the trial.
"""

import os
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from filelock import FileLock

from parking_exp.config.paths import refuse_links
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, ParkingError, StoreError, first_line
from parking_exp.runs.locks import is_held
from parking_exp.tuning.search_config import Dimension, SearchConfig

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.samplers import BaseSampler
    from optuna.trial import FrozenTrial

STUDY_FILE = "study.journal"
CLAIM_LOCK = ".claiming"
TRIALS_FOLDER = ".trials"
DEFINITION = "definition"  # attribute of a study
# Attributes of a trial.
RUNS = "runs"
REASON = "reason"
SEED_VALUES = "by_seed"


class OpenStudy(NamedTuple):
    """A study that trials are claimed from, its storage, and the folder of the search."""

    study: "Study"
    storage: Any
    folder: Path


class _JournalLock:
    """Lock the journal for Optuna; the system releases it when the process dies."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = FileLock(f"{path}.lock")

    def acquire(self) -> bool:
        """Wait for the lock, and remove an incomplete last line, left by a kill or a full disk."""
        self._lock.acquire()
        content = self._path.read_bytes()
        os.truncate(self._path, content.rfind(b"\n") + 1)
        return True

    def release(self) -> None:
        """Release the lock."""
        self._lock.release()


@contextmanager
def as_store_error(name: str) -> Iterator[None]:
    """Turn all errors of reading a journal, which may be damaged in any way, into a StoreError."""
    try:
        yield
    except ParkingError:
        raise
    except Exception as error:
        raise StoreError(f"the study {name} can't be used: {first_line(error)}") from error


def open_storage(folder: Path) -> Any:
    """Open the storage of a study: the journal in the search's folder, which is made if need be.

    Raises:
        UntrustedError: a file of the search is a symbolic link that leads out of its folder.
    """
    import optuna
    from optuna.storages.journal import JournalFileBackend, JournalStorage

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    own_files = [*folder.glob(".*"), *folder.glob("study.*"), *folder.glob(f"{TRIALS_FOLDER}/*")]
    refuse_links(own_files, folder)  # cells' folders may be on another disk
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / STUDY_FILE
    return JournalStorage(JournalFileBackend(str(path), lock_obj=cast(Any, _JournalLock(path))))


def open_study(
    folder: Path,
    search: SearchConfig,
    base: RunConfig,
    values: Mapping[str, Any],
    option_keys: Mapping[str, str],
) -> OpenStudy:
    """Return the study of a search; create it, with trial 0, if there is none.

    Args:
        folder: the experiment's folder.
        search: the settings of the search.
        base: the config that trials change.
        values: value of each key of the space in this config.
        option_keys: run key with each option that trials choose from.

    Raises:
        ConfigError: the study was made with another space, seeds, evaluation, base config or
            contents of an option.
        StoreError: the journal can't be read.
    """
    import optuna

    name = folder.name
    with as_store_error(name):
        storage = open_storage(folder)
        with FileLock(folder / CLAIM_LOCK):
            study = optuna.create_study(
                storage=storage, study_name=name, direction="maximize", load_if_exists=True
            )
            _check_definition(study, {**_definition(search, base), **option_keys})
            if not study.trials:
                _add_unchanged(study, search, values)
    return OpenStudy(study, storage, folder)


def _definition(search: SearchConfig, base: RunConfig) -> dict[str, Any]:
    """Return what must not change for trials to be comparable."""
    definition: dict[str, Any] = {
        f"search.space.{key}": str(dimension) for key, dimension in search.space.items()
    }
    definition["search.tuning_seeds"] = search.tuning_seeds
    definition["evaluation.final_n_scenes"] = base.evaluation.final_n_scenes
    definition["base config"] = base.model_copy(update={"seed": 0}).run_key
    return definition


def _check_definition(study: "Study", definition: Mapping[str, Any]) -> None:
    """Refuse a study whose trials are not comparable; note what a new one is made with."""
    known = study.user_attrs.get(DEFINITION)
    if known is None:
        study.set_user_attr(DEFINITION, definition)
        return
    keys = {**known, **definition}
    differing = [key for key in keys if known.get(key) != definition.get(key)]
    if differing:
        raise ConfigError(
            f"the study {study.study_name} was made with another {', '.join(differing)}; restore "
            "that to resume it, or start another study with experiment_name=OTHER"
        )


def _add_unchanged(study: "Study", search: SearchConfig, values: Mapping[str, Any]) -> None:
    """Add trial 0, the unchanged config; it has the parameters that are inside the space."""
    from optuna.trial import TrialState, create_trial

    parameters = {}
    for key, dimension in search.space.items():
        parameter = dimension.to_parameter(values[key])
        if parameter is not None:
            parameters[key] = parameter
    distributions = {key: search.space[key].distribution() for key in parameters}
    # It is running but not locked, so that it is claimed like an abandoned trial.
    study.add_trial(
        create_trial(state=TrialState.RUNNING, params=parameters, distributions=distributions)
    )


def trial_lock_path(folder: Path, number: int) -> Path:
    """Return the path of a trial's lock file."""
    return folder / TRIALS_FOLDER / f"{number:05d}.lock"


def claim(
    opened: OpenStudy, search: SearchConfig, n_trials: int
) -> "tuple[Trial, FileLock] | None":
    """Resume an abandoned trial or begin the next one, and lock it; None if none is left."""
    import optuna

    study, storage, folder = opened
    with FileLock(folder / CLAIM_LOCK):
        number = _next_number(study, folder, n_trials)
        if number is None:
            return None
        seed = zlib.crc32(f"{study.study_name} {number}".encode())
        study.sampler = make_sampler(search, seed)
        if number == len(study.trials):
            trial = study.ask({key: each.distribution() for key, each in search.space.items()})
        else:
            study_id = storage.get_study_id_from_name(study.study_name)
            trial_id = storage.get_trial_id_from_study_id_trial_number(study_id, number)
            trial = optuna.Trial(study, trial_id)
        path = trial_lock_path(folder, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, thread_local=False)
        lock.acquire()
    return trial, lock


def _next_number(study: "Study", folder: Path, n_trials: int) -> int | None:
    """Return the number of an abandoned trial or of the next one; None: none is left."""
    locks = {number: trial_lock_path(folder, number) for number in range(n_trials)}
    locked_numbers = {number for number, path in locks.items() if is_held(path)}
    trials = study.trials[:n_trials]  # read after the locks: a trial may just have ended
    for trial in trials:
        if trial.state.name == "RUNNING" and trial.number not in locked_numbers:
            return trial.number
    return len(trials) if len(trials) < n_trials else None


def changes_of(trial: "Trial | FrozenTrial", space: Mapping[str, Dimension]) -> dict[str, Any]:
    """Return the values of keys that a trial changes; trial 0 changes none."""
    if trial.number == 0:
        return {}
    return {key: space[key].to_value(parameter) for key, parameter in trial.params.items()}


def make_sampler(search: SearchConfig, seed: int) -> "BaseSampler":
    """Return a sampler with the seed of one trial, so that a restart repeats no trial."""
    from optuna import samplers
    from optuna.exceptions import ExperimentalWarning

    if search.sampler == "random":
        return samplers.RandomSampler(seed=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        # `group`: trial 0 may lack parameters.
        return samplers.TPESampler(multivariate=True, group=True, constant_liar=True, seed=seed)

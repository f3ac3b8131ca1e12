"""The study of a search: Optuna's record of its trials.

The study is a journal file in the experiment's folder, or is in the database of `storage`. Trials are numbered from 0;
those from 0 to n_trials - 1 are trained.
"""

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from filelock import FileLock, Timeout

from parking_exp.config.credentials import strip_password, with_password
from parking_exp.config.paths import refuse_links
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, ParkingError, StoreError
from parking_exp.tuning.search_config import SearchConfig
from parking_exp.tuning.space import applies, in_order, parameter, to_parameter

if TYPE_CHECKING:
    from optuna import Study, Trial

STUDY_FILE, CLAIM_LOCK, TRIALS_FOLDER = "study.journal", ".claiming", ".trials"
Values = Callable[[Mapping[str, Any]], Mapping[str, Any]]
DEFINITION = "definition"  # attribute of a study
# Attributes of a trial.
CHANGES, ENQUEUED, RUNS, REASON = "changes", "enqueued", "runs", "reason"
SEED_VALUES, STEPS, CPU_S = "values_by_seed", "env_steps", "cpu_s"
CLAIM_PATIENCE_S = 120.0


@dataclass(frozen=True)
class OpenStudy:
    """A study that trials are claimed from: Optuna's study, its storage, and the folder of the search."""

    study: "Study"
    storage: Any
    folder: Path

    def trial(self, number: int) -> "Trial":
        """Return a running trial, begun by this process or another one."""
        import optuna

        study_id = self.storage.get_study_id_from_name(self.study.study_name)
        return optuna.Trial(self.study, self.storage.get_trial_id_from_study_id_trial_number(study_id, number))


def trial_lock_path(folder: Path, number: int) -> Path:
    """Return the lock file of a trial, held by the process that works on it."""
    return folder / TRIALS_FOLDER / f"{number:05d}.lock"


class _JournalLock:
    """Lock of the journal for Optuna: the system releases it when its process dies."""

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, FileLock(f"{path}.lock")

    def acquire(self) -> bool:
        """Wait for the lock, and remove an incomplete last line, which a kill or a full disk leaves."""
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


def storage_of(folder: Path, uri: str | None) -> Any:
    """Return the storage of a study: the database at a URI, or without one the journal in the search's folder.

    Raises:
        StoreError: it can't be reached.
        UntrustedError: a file of the search is a symbolic link that leads out of its folder.
    """
    import optuna
    from optuna.storages.journal import JournalFileBackend
    from sqlalchemy.exc import DBAPIError

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    path = folder / STUDY_FILE
    # The folders of cells may be on another disk.
    refuse_links((one for names in (".*", "study.*", f"{TRIALS_FOLDER}/*") for one in folder.glob(names)), folder)
    try:
        if uri is None:
            folder.mkdir(parents=True, exist_ok=True)
            path.touch()
            backend = JournalFileBackend(str(path), lock_obj=cast(Any, _JournalLock(path)))
            return optuna.storages.JournalStorage(backend)
        for wait_s in (1, 1, None):  # of two processes that create the same tables at once, one fails
            try:
                return optuna.storages.get_storage(with_password(uri))
            except DBAPIError:
                if wait_s is None:
                    raise
                time.sleep(wait_s)
    except Exception as error:  # any driver of a database may be behind it
        raise StoreError(f"storage={uri or path}: the study can't be opened: {_first_line(error)}") from error


def open_study(folder: Path, search: SearchConfig, base: RunConfig, values: Values, storage: Any) -> OpenStudy:
    """Return the study of a search; create it with trial 0 and the enqueued configs if there is none.

    Args:
        folder: of the experiment.
        search: the search.
        base: the config that trials change.
        values: changes -> values of the keys of the space in the config with these changes.
        storage: see `storage_of`.

    Raises:
        ConfigError: the study was made with another space, objective, seeds or base config.
        StoreError: the storage fails.
    """
    import optuna

    name = folder.name
    with claiming(folder), storage_errors(name):
        study = optuna.create_study(
            storage=storage, study_name=name, directions=["maximize"] * len(search.objective), load_if_exists=True
        )
        definition = _definition(search, base)
        if (known := study.user_attrs.get(DEFINITION)) is None:
            study.set_user_attr(DEFINITION, definition)
        elif known != definition:
            raise ConfigError(_other_definition(name, known, definition))
        _enqueue(study, search, values)
        return OpenStudy(study, storage, folder)


def load_study(name: str, storage: Any) -> "Study | None":
    """Return the study of a search for reading, or None if there is none.

    Raises:
        StoreError: the storage fails.
    """
    import optuna

    with storage_errors(name), suppress(KeyError):
        return optuna.load_study(study_name=name, storage=storage)
    return None


@contextmanager
def storage_errors(name: str) -> Iterator[None]:
    """Raise errors of a storage as one sentence.

    Raises:
        ConfigError: the study can't be used.
        StoreError: the storage fails.
    """
    try:
        yield
    except ParkingError:
        raise
    except ValueError as error:  # a damaged journal, or other directions
        raise ConfigError(f"study {name} can't be used: {error}; start another with experiment_name=OTHER") from error
    except Exception as error:
        raise StoreError(f"the storage of study {name} fails: {_first_line(error)}; try again later") from error


def _first_line(error: Exception) -> str:
    return strip_password((str(error).splitlines() or [type(error).__name__])[0])


def _definition(search: SearchConfig, base: RunConfig) -> dict[str, Any]:
    """Return what must not change for trials to be comparable: objective, seeds, space and base config."""
    plain = json.loads(json.dumps(search.model_dump(by_alias=True, exclude_defaults=True)))
    found = {f"search.{key}": plain[key] for key in ("objective", "tuning_seeds", "enqueue")}
    found |= {f"search.space.{key}": value for key, value in plain["space"].items()}
    return found | {"config": base.model_copy(update={"seed": 0}).run_key}


def _other_definition(name: str, known: Mapping[str, Any], asked: Mapping[str, Any]) -> str:
    differing = [
        f"{key} was {json.dumps(known.get(key))} and is {json.dumps(asked.get(key))}"
        if key != "config"
        else "other keys of the base config differ"
        for key in {**known, **asked}
        if known.get(key) != asked.get(key)
    ]
    return (
        f"the study {name} was made for another search: {'; '.join(differing)}; restore that to resume it, or start "
        "another with experiment_name=OTHER"
    )


@contextmanager
def claiming(folder: Path) -> Iterator[None]:
    """Be the only process that begins or resumes a trial.

    Raises:
        StoreError: another process holds the lock for minutes.
    """
    try:
        with FileLock(folder / CLAIM_LOCK, timeout=CLAIM_PATIENCE_S):
            yield
    except Timeout as error:
        raise StoreError(
            f"{folder / CLAIM_LOCK} has been held for {CLAIM_PATIENCE_S:.0f} s by another process"
        ) from error


def _enqueue(study: "Study", search: SearchConfig, values: Values) -> None:
    """Enqueue the unchanged config and `search.enqueue` as the first trials, where they are missing."""
    first: list[dict[str, Any]] = [{}, *search.enqueue]
    for changes in first[len(study.get_trials(deepcopy=False)) :]:
        known = known_parameters(search, values(changes))
        study.enqueue_trial(known, user_attrs={ENQUEUED: sorted(known), CHANGES: changes})


def known_parameters(search: SearchConfig, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return Optuna's parameters for the values of a config that are inside the space."""
    known: dict[str, Any] = {}
    chosen: dict[str, Any] = {}
    for key, dimension in in_order(search):
        value = to_parameter(dimension, values.get(key))
        if value is not None and applies(dimension, chosen):
            known[parameter(key, dimension)] = value
            chosen[key] = values[key]
    return known

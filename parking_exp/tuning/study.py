"""The study of a search: Optuna's record of its trials, and which process works on which trial.

The study is a journal file in the experiment's folder. A process holds a lock file while it works
on a trial; once that process has died, another one resumes the trial.
"""

import json
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
from parking_exp.runs.atomic_files import open_file
from parking_exp.runs.directory import is_held
from parking_exp.tuning.search_config import SearchConfig

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.samplers import BaseSampler

STUDY_FILE, CLAIM_LOCK, TRIALS_FOLDER = "study.journal", ".claiming", ".trials"
DEFINITION = "definition"  # attribute of a study
CHANGES, RUNS, REASON, SEED_VALUES = "changes", "runs", "reason", "by_seed"  # attributes of a trial


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
def study_errors(name: str) -> Iterator[None]:
    """Turn all errors of reading a journal, which may be damaged in any way, into a StoreError."""
    try:
        yield
    except ParkingError:
        raise
    except Exception as error:
        raise StoreError(f"the study {name} can't be used: {first_line(error)}") from error


def storage_of(folder: Path) -> Any:
    """Return the storage of a study: the journal in the search's folder.

    Raises:
        UntrustedError: a file of the search is a symbolic link that leads out of its folder.
    """
    import optuna
    from optuna.storages.journal import JournalFileBackend, JournalStorage

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    path = folder / STUDY_FILE
    # Not all files of the folder: those of cells may be on another disk.
    refuse_links(
        (file for names in (".*", "study.*", f"{TRIALS_FOLDER}/*") for file in folder.glob(names)),
        folder,
    )
    if not path.exists():  # status and report read studies of directories that are read-only
        folder.mkdir(parents=True, exist_ok=True)
        path.touch()
    open_file(path).close()  # Optuna would read it whatever its size
    return JournalStorage(JournalFileBackend(str(path), lock_obj=cast(Any, _JournalLock(path))))


def open_study(
    folder: Path,
    search: SearchConfig,
    base: RunConfig,
    values: Mapping[str, Any],
    option_keys: Mapping[str, str] | None = None,
) -> OpenStudy:
    """Return the study of a search; create it, with trial 0, the unchanged config, if there is
    none.

    Args:
        folder: of the experiment.
        base: the config that trials change.
        values: value of each key of the space in this config.
        option_keys: run key of this config with each option that trials choose from.

    Raises:
        ConfigError: the study was made with another space, seeds, base config, or contents of an
            option.
        StoreError: the journal can't be read.
    """
    import optuna
    from optuna.trial import TrialState, create_trial

    name = folder.name
    with study_errors(name):
        storage = storage_of(folder)
        with FileLock(folder / CLAIM_LOCK):
            study = optuna.create_study(
                storage=storage, study_name=name, direction="maximize", load_if_exists=True
            )
            definition = {**_definition(search, base), **(option_keys or {})}
            known = study.user_attrs.get(DEFINITION)
            if known is None:
                study.set_user_attr(DEFINITION, definition)
            elif differing := [
                key for key in {**known, **definition} if known.get(key) != definition.get(key)
            ]:
                raise ConfigError(
                    f"the study {name} was made with another {', '.join(differing)}; restore that "
                    "to resume it, or "
                    "start another study with experiment_name=OTHER"
                )
            if not study.get_trials(deepcopy=False):
                parameters = {
                    key: dimension.to_parameter(values[key])
                    for key, dimension in search.space.items()
                }
                inside = {key: value for key, value in parameters.items() if value is not None}
                distributions = {key: search.space[key].distribution() for key in inside}
                # Added as running but not locked, so that it is claimed like an abandoned trial.
                study.add_trial(
                    create_trial(
                        state=TrialState.RUNNING,
                        params=inside,
                        distributions=distributions,
                        user_attrs={CHANGES: {}},
                    )
                )
    return OpenStudy(study, storage, folder)


def _definition(search: SearchConfig, base: RunConfig) -> dict[str, Any]:
    """Return what must not change for trials to be comparable: seeds, space, base config and
    evaluation.
    """
    plain = json.loads(search.model_dump_json(by_alias=True, exclude_none=True))
    definition = {f"search.space.{key}": value for key, value in plain["space"].items()}
    definition["search.tuning_seeds"] = search.tuning_seeds
    definition["evaluation.final_n_scenes"] = base.evaluation.final_n_scenes
    definition["base config"] = base.model_copy(update={"seed": 0}).run_key
    return definition


def trial_lock_path(folder: Path, number: int) -> Path:
    """Return the path of a trial's lock file."""
    return folder / TRIALS_FOLDER / f"{number:05d}.lock"


def claim(
    opened: OpenStudy, search: SearchConfig, n_trials: int
) -> "tuple[Trial, FileLock] | None":
    """Resume an abandoned trial or begin the next one; return it and the lock to release, or None
    if none is left.
    """
    import optuna

    study, storage, folder = opened
    with FileLock(folder / CLAIM_LOCK):
        held = {number for number in range(n_trials) if is_held(trial_lock_path(folder, number))}
        trials = study.get_trials(deepcopy=False)[
            :n_trials
        ]  # after the locks: a trial may just have ended
        abandoned = [t.number for t in trials if t.state.name == "RUNNING" and t.number not in held]
        number = abandoned[0] if abandoned else len(trials)
        if number == n_trials:
            return None
        if abandoned:
            study_id = storage.get_study_id_from_name(study.study_name)
            trial = optuna.Trial(
                study, storage.get_trial_id_from_study_id_trial_number(study_id, number)
            )
        else:
            study.sampler = make_sampler(
                search, zlib.crc32(f"{study.study_name} {number}".encode())
            )
            trial = study.ask(
                {key: dimension.distribution() for key, dimension in search.space.items()}
            )
        if (
            CHANGES not in trial.user_attrs
        ):  # a process may have died before it had sampled all of them
            changes = {
                key: search.space[key].to_value(parameter)
                for key, parameter in trial.params.items()
            }
            trial.set_user_attr(CHANGES, changes)
        path = trial_lock_path(folder, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = FileLock(path, thread_local=False)
        lock.acquire()
    return trial, lock


def make_sampler(search: SearchConfig, seed: int) -> "BaseSampler":
    """Return the sampler of a search; each trial has a seed of its own, so that a restart repeats
    none.
    """
    from optuna import samplers
    from optuna.exceptions import ExperimentalWarning

    if search.sampler == "random":
        return samplers.RandomSampler(seed=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        # `group`: trial 0 may lack parameters.
        return samplers.TPESampler(multivariate=True, group=True, constant_liar=True, seed=seed)

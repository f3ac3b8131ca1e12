"""The study of a search: Optuna's record of its trials, and which process works on which trial.

The study is a journal file in the experiment's folder, or lies where `storage` says. Trials are numbered from 0; those
from 0 to n_trials - 1 are trained. A process holds a lock file as long as it works on a trial, so that a trial whose
worker was killed is found and goes on, here at once and on other machines once its last sign of life is old.
"""

import json
import os
import socket
import time
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from filelock import FileLock, Timeout

from parking_exp.config.paths import without_password
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, StoreError
from parking_exp.runs.locks import is_held
from parking_exp.tuning.schema import SearchConfig
from parking_exp.tuning.space import applies, in_order, parameter, suggest, to_parameter, to_value

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.samplers import BaseSampler
    from optuna.trial import FrozenTrial

STUDY_FILE, TRIALS_FOLDER, CLAIM_LOCK = "study.journal", ".trials", ".claiming"
DEFINITION, UNIT_COSTS = "definition", "unit_costs"
CHANGES, SIGN_OF_LIFE, ENQUEUED = "changes", "alive", "enqueued"
LOST_S = 180.0  # of a trial on another machine: no sign of life for so long
SIGN_S = 30.0
CLAIM_PATIENCE_S = 120.0
HIGHER_IS_BETTER = {"success_auc": True, "final_success": True, "final_parked": True, "cost_to_95": False}


class _JournalLock:
    """Lock of the journal for Optuna: the system releases it when its process dies, and half a line goes with it."""

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, FileLock(f"{path}.lock")

    def acquire(self) -> bool:
        """Wait for the lock, and cut off what a process that was killed, or a full disk, left of a line."""
        self._lock.acquire()
        with self._path.open("r+b") as file:
            content_end = file.seek(0, os.SEEK_END)
            start = max(0, content_end - 2**20)
            file.seek(start)
            tail = file.read()
            if tail and not tail.endswith(b"\n"):
                file.truncate(start + tail.rfind(b"\n") + 1)
        return True

    def release(self) -> None:
        """Release the lock."""
        self._lock.release()


def storage_of(folder: Path, url: str | None) -> Any:
    """Return the storage of a search's study.

    Raises:
        StoreError: it can't be reached.
    """
    import optuna
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    path = folder / STUDY_FILE
    try:
        if url is None:
            folder.mkdir(parents=True, exist_ok=True)
            path.touch()
            backend = JournalFileBackend(str(path), lock_obj=cast(Any, _JournalLock(path)))
            return optuna.storages.JournalStorage(backend)
        return optuna.storages.get_storage(url)
    except Exception as error:  # any driver of a database may be behind it
        raise StoreError(
            f"storage={without_password(url or str(path))}: the study can't be opened: {_first_line(error)}"
        ) from error


def directions(search: SearchConfig) -> list[Literal["maximize", "minimize"]]:
    """Return Optuna's direction of each objective."""
    return ["maximize" if HIGHER_IS_BETTER[name] else "minimize" for name in search.objectives]


def open_study(folder: Path, search: SearchConfig, base: RunConfig, values: Mapping[str, Any], storage: Any) -> "Study":
    """Return the study of a search, made with trial 0 and what is enqueued if there is none yet.

    Args:
        folder: of the experiment.
        search: the search.
        base: the config that trials change.
        values: of the keys of the space in that config.
        storage: see `storage_of`.

    Raises:
        ConfigError: the study was made with another space, objective, seeds or base config.
        StoreError: the storage fails.
    """
    import optuna

    name = folder.name
    with claiming(folder), _storage_errors(name):
        study = optuna.create_study(
            storage=storage, study_name=name, directions=directions(search), load_if_exists=True
        )
        definition = _definition(search, base)
        if (known := study.user_attrs.get(DEFINITION)) is None:
            study.set_user_attr(DEFINITION, definition)
        elif known != definition:
            raise ConfigError(_other_definition(name, known, definition))
        _enqueue(study, search, values)
        return study


def load_study(name: str, storage: Any) -> "Study | None":
    """Return the study of a search that was begun, for reading; None where there is none.

    Raises:
        StoreError: the storage fails.
    """
    import optuna

    try:
        return optuna.load_study(study_name=name, storage=storage)
    except KeyError:
        return None
    except Exception as error:
        raise StoreError(f"the study {name} can't be read: {_first_line(error)}") from error


@contextmanager
def _storage_errors(name: str) -> Iterator[None]:
    try:
        yield
    except (ConfigError, StoreError):
        raise
    except ValueError as error:  # of a journal that is damaged, of directions that differ
        raise ConfigError(f"the study {name} can't be used: {error}; experiment_name=OTHER begins another") from error
    except Exception as error:
        raise StoreError(f"the storage of study {name} fails: {_first_line(error)}; type it again later") from error


def _first_line(error: Exception) -> str:
    return without_password((str(error).splitlines() or [type(error).__name__])[0])


def _definition(search: SearchConfig, base: RunConfig) -> dict[str, Any]:
    """Return what makes values of trials comparable: all of the search, and the config that trials change."""
    plain = json.loads(json.dumps(search.model_dump(by_alias=True, exclude_defaults=False)))
    found = {f"search.{key}": plain[key] for key in ("objective", "tuning_seeds", "enqueue")}
    found |= {f"search.space.{key}": value for key, value in plain["space"].items()}
    return found | {"config": base.model_copy(update={"seed": 0}).run_key}


def _other_definition(name: str, known: Mapping[str, Any], asked: Mapping[str, Any]) -> str:
    differing = [key for key in {**known, **asked} if known.get(key) != asked.get(key)]
    key = differing[0]
    if key == "config":
        what = "with other keys of the config that its trials change"
    else:
        short = (
            {k: v for k, v in (one.get(key) or {}).items() if v} if isinstance(one.get(key), dict) else one.get(key)
            for one in (known, asked)
        )
        was, now = (json.dumps(one) if one else "absent" for one in short)
        what = f"with another search: {key} was {was} and is {now}"
    more = f" ({len(differing) - 1} more keys differ)" if len(differing) > 1 else ""
    return (
        f"the study {name} was made {what}{more}; type what it was made with to go on with it, or "
        "experiment_name=OTHER to begin another"
    )


@contextmanager
def claiming(folder: Path) -> Iterator[None]:
    """Be the only process on this machine that begins or takes up a trial.

    Raises:
        StoreError: another one has been at it for minutes.
    """
    try:
        with FileLock(folder / CLAIM_LOCK, timeout=CLAIM_PATIENCE_S):
            yield
    except Timeout as error:
        raise StoreError(
            f"{folder / CLAIM_LOCK} has been held for {CLAIM_PATIENCE_S:.0f} s by another process"
        ) from error


def make_sampler(search: SearchConfig, seed: int) -> "BaseSampler":
    """Return the sampler of a search; its random numbers depend on the seed alone."""
    from optuna import samplers
    from optuna.exceptions import ExperimentalWarning

    match search.sampler:
        case "random":
            return samplers.RandomSampler(seed=seed)
        case "cmaes":
            return samplers.CmaEsSampler(seed=seed, warn_independent_sampling=False)
        case "gp":
            return samplers.GPSampler(seed=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        # `group`: where trials lack parameters because of conditions, those that come together are sampled together.
        return samplers.TPESampler(multivariate=True, group=True, constant_liar=True, seed=seed)


def seed_of(study: str, trial: int) -> int:
    """Return the seed of a trial's sampling: trials that are sampled after a restart are not those before it."""
    return zlib.crc32(f"{study} {trial}".encode())


class Claim:
    """A trial that this process works on, until it is released."""

    def __init__(self, trial: "Trial", lock: FileLock) -> None:
        self.trial, self._lock = trial, lock
        self._signed = 0.0

    @property
    def number(self) -> int:
        """The trial's number."""
        return self.trial.number

    @property
    def changes(self) -> dict[str, Any]:
        """What the trial changes in the search's config."""
        return dict(self.trial.user_attrs[CHANGES])

    def sign(self) -> None:
        """Leave a sign of life for other machines, not more often than they look."""
        if time.monotonic() - self._signed > SIGN_S:
            self._signed = time.monotonic()
            self.trial.set_user_attr(SIGN_OF_LIFE, {"host": socket.gethostname(), "time": time.time()})

    def release(self) -> None:
        """Leave the trial to whoever takes it up next, or to nobody if it is over."""
        self._lock.release()


def claim(study: "Study", folder: Path, search: SearchConfig, n_trials: int) -> Claim | None:
    """Take up a trial that nobody works on any more, or begin the next one; None where none is left to this process."""
    import optuna

    with claiming(folder):
        trials = study.get_trials(deepcopy=False)[:n_trials]
        for frozen in trials:
            if frozen.state.name == "RUNNING" and (lock := _lock_if_lost(folder, frozen)) is not None:
                study.sampler = make_sampler(search, seed_of(study.study_name, frozen.number))
                return _claimed(search, optuna.Trial(study, frozen._trial_id), lock)
        if len(trials) == n_trials and not any(frozen.state.name == "WAITING" for frozen in trials):
            return None
        study.sampler = make_sampler(search, seed_of(study.study_name, len(trials)))
        trial = study.ask()
        if trial.number >= n_trials:  # another machine was faster; what was begun here is not trained
            study.tell(trial, state=optuna.trial.TrialState.FAIL)
            return None
        lock = _trial_lock(folder, trial.number)
        lock.acquire()
        return _claimed(search, trial, lock)


def _claimed(search: SearchConfig, trial: "Trial", lock: FileLock) -> Claim:
    """Sample what a trial has no value of yet, and write down what it changes."""
    taken = Claim(trial, lock)
    try:
        taken.sign()
        given = trial.user_attrs.get(ENQUEUED)
        chosen: dict[str, Any] = {}
        for key, dimension in in_order(search):
            name = parameter(key, dimension)
            if applies(dimension, chosen) if given is None else name in given:
                chosen[key] = to_value(dimension, suggest(trial, name, dimension))
        if CHANGES not in trial.user_attrs:
            trial.set_user_attr(CHANGES, chosen)
    except BaseException:
        taken.release()
        raise
    return taken


def _enqueue(study: "Study", search: SearchConfig, base: Mapping[str, Any]) -> None:
    """Have the config as it stands, and what is to be tried after it, as the first trials, as far as they are not."""
    typed: list[dict[str, Any]] = [{}, *search.enqueue]
    for changes in typed[len(study.get_trials(deepcopy=False)) :]:
        known = known_parameters(search, {**base, **changes})
        study.enqueue_trial(known, user_attrs={ENQUEUED: sorted(known), CHANGES: changes})


def known_parameters(search: SearchConfig, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return Optuna's parameters of a config, as far as the space has its values."""
    found: dict[str, Any] = {}
    chosen: dict[str, Any] = {}
    for key, dimension in in_order(search):
        one = to_parameter(dimension, values.get(key))
        if one is not None and applies(dimension, chosen):
            found[parameter(key, dimension)] = one
            chosen[key] = values[key]
    return found


def _trial_lock(folder: Path, number: int) -> FileLock:
    (folder / TRIALS_FOLDER).mkdir(parents=True, exist_ok=True)
    return FileLock(folder / TRIALS_FOLDER / f"{number:05d}.lock", thread_local=False)


def _lock_if_lost(folder: Path, frozen: "FrozenTrial") -> FileLock | None:
    """Lock a trial if no process works on it, else return None."""
    alive = frozen.user_attrs.get(SIGN_OF_LIFE, {})
    began = frozen.datetime_start.timestamp() if frozen.datetime_start else 0.0
    elsewhere = alive.get("host") not in (None, socket.gethostname())
    if elsewhere and time.time() - max(alive.get("time", 0.0), began) < LOST_S:
        return None
    lock = _trial_lock(folder, frozen.number)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return None
    return lock


def worked_on(folder: Path, frozen: "FrozenTrial") -> bool:
    """Whether a process works on a trial, as far as this machine can tell."""
    alive = frozen.user_attrs.get(SIGN_OF_LIFE, {})
    if alive.get("host") not in (None, socket.gethostname()):
        return time.time() - alive.get("time", 0.0) < LOST_S
    return is_held(folder / TRIALS_FOLDER / f"{frozen.number:05d}.lock")

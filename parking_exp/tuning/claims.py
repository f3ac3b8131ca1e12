"""Which process works on which trial: claiming one, sampling its parameters, and finding those that were left.

A process holds a lock file as long as it works on a trial, so that a trial whose worker was killed is found and goes
on: here at once, on other machines once its last heartbeat is old.
"""

import socket
import time
import warnings
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from parking_exp.runs.locks import is_held
from parking_exp.tuning.schema import SearchConfig
from parking_exp.tuning.space import applies, in_order, parameter, suggest, to_value
from parking_exp.tuning.study import CHANGES, ENQUEUED, HEARTBEAT, TRIALS_FOLDER, claiming

if TYPE_CHECKING:
    from optuna import Study, Trial
    from optuna.samplers import BaseSampler
    from optuna.trial import FrozenTrial

LOST_S = 180.0  # of a trial on another machine: no heartbeat for so long
HEARTBEAT_S = 30.0


class Claim:
    """A trial that this process works on, until it is released."""

    def __init__(self, trial: "Trial", folder: Path, lock: FileLock) -> None:
        self.trial, self.folder, self._lock = trial, folder, lock
        self._last_heartbeat = float("-inf")

    @property
    def number(self) -> int:
        """The trial's number."""
        return self.trial.number

    @property
    def changes(self) -> dict[str, Any]:
        """What the trial changes in the search's config."""
        return dict(self.trial.user_attrs[CHANGES])

    def send_heartbeat(self) -> None:
        """Leave a heartbeat for other machines, every HEARTBEAT_S at most."""
        if time.monotonic() - self._last_heartbeat > HEARTBEAT_S:
            self._last_heartbeat = time.monotonic()
            self.trial.set_user_attr(
                HEARTBEAT, {"host": socket.gethostname(), "folder": str(self.folder), "time": time.time()}
            )

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
                if study.get_trials(deepcopy=False)[frozen.number].state.name != "RUNNING":  # it has just ended
                    lock.release()
                    continue
                study.sampler = make_sampler(search, seed_of(study.study_name, frozen.number))
                return _claimed(search, optuna.Trial(study, frozen._trial_id), folder, lock)
        if len(trials) == n_trials and not any(frozen.state.name == "WAITING" for frozen in trials):
            return None
        study.sampler = make_sampler(search, seed_of(study.study_name, len(trials)))
        trial = study.ask()
        if trial.number >= n_trials:  # another machine was faster; a call with more trials takes it up
            return None
        lock = _trial_lock(folder, trial.number)
        lock.acquire()
        return _claimed(search, trial, folder, lock)


def _claimed(search: SearchConfig, trial: "Trial", folder: Path, lock: FileLock) -> Claim:
    """Sample what a trial has no value of yet, and write down what it changes."""
    taken = Claim(trial, folder, lock)
    try:
        taken.send_heartbeat()
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


def make_sampler(search: SearchConfig, seed: int) -> "BaseSampler":
    """Return the sampler of a search; its random numbers depend on the seed alone."""
    from optuna import samplers
    from optuna.exceptions import ExperimentalWarning

    if search.sampler == "random":
        return samplers.RandomSampler(seed=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        # `group`: where trials lack parameters because of conditions, those that come together are sampled together.
        return samplers.TPESampler(multivariate=True, group=True, constant_liar=True, seed=seed)


def seed_of(study: str, trial: int) -> int:
    """Return the seed of a trial's sampling: trials that are sampled after a restart are not those before it."""
    return zlib.crc32(f"{study} {trial}".encode())


def _trial_lock(folder: Path, number: int) -> FileLock:
    (folder / TRIALS_FOLDER).mkdir(parents=True, exist_ok=True)
    return FileLock(folder / TRIALS_FOLDER / f"{number:05d}.lock", thread_local=False)


def _lock_if_lost(folder: Path, frozen: "FrozenTrial") -> FileLock | None:
    """Lock a trial if no process works on it, else return None."""
    heartbeat = _heartbeat(frozen)
    began = frozen.datetime_start.timestamp() if frozen.datetime_start else 0.0
    if _is_elsewhere(heartbeat, folder) and time.time() - max(heartbeat["time"], began) < LOST_S:
        return None
    lock = _trial_lock(folder, frozen.number)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return None
    return lock


def worked_on(folder: Path, frozen: "FrozenTrial") -> bool:
    """Whether a process works on a trial, as far as this machine can tell."""
    heartbeat = _heartbeat(frozen)
    if _is_elsewhere(heartbeat, folder):
        return time.time() - heartbeat["time"] < LOST_S
    return is_held(folder / TRIALS_FOLDER / f"{frozen.number:05d}.lock")


def _heartbeat(frozen: "FrozenTrial") -> Mapping[str, Any]:
    """Return the last heartbeat of a trial; {} where it has none, or something else in its place."""
    found = frozen.user_attrs.get(HEARTBEAT)
    return found if isinstance(found, dict) and isinstance(found.get("time"), int | float) else {}


def _is_elsewhere(heartbeat: Mapping[str, Any], folder: Path) -> bool:
    """Whether a heartbeat is of another machine, or of a search in another folder, whose lock files are not ours."""
    return bool(heartbeat) and (heartbeat.get("host"), heartbeat.get("folder")) != (socket.gethostname(), str(folder))

"""Decide which process works on which trial: claim one, sample its parameters, and find abandoned ones.

A process holds a lock file while it works on a trial. The system releases it when the process dies, so that the next
process to look resumes the trial. Optuna's own heartbeat is for `study.optimize` on databases only.
"""

import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock, Timeout

from parking_exp.tuning.search_config import SearchConfig
from parking_exp.tuning.space import applies, in_order, parameter, suggest, to_value
from parking_exp.tuning.study import CHANGES, ENQUEUED, OpenStudy, claiming, trial_lock_path

if TYPE_CHECKING:
    from optuna import Trial
    from optuna.samplers import BaseSampler


class Claim:
    """A trial that this process works on, until it is released."""

    def __init__(self, trial: "Trial", lock: FileLock) -> None:
        self.trial, self._lock = trial, lock

    @property
    def number(self) -> int:
        """The trial's number."""
        return self.trial.number

    @property
    def changes(self) -> dict[str, Any]:
        """Overrides of the search's config that the trial sets."""
        return dict(self.trial.user_attrs[CHANGES])

    def release(self) -> None:
        """Leave the trial to whoever claims it next, unless it is over."""
        self._lock.release()


def claim(opened: OpenStudy, search: SearchConfig, n_trials: int) -> Claim | None:
    """Resume an abandoned trial or begin the next one; return None where none is left for this process."""
    study, folder = opened.study, opened.folder
    with claiming(folder):
        trials = study.get_trials(deepcopy=False)[:n_trials]
        for frozen in trials:
            if frozen.state.name == "RUNNING" and (lock := _try_lock(folder, frozen.number)) is not None:
                if study.get_trials(deepcopy=False)[frozen.number].state.name != "RUNNING":  # it has just ended
                    lock.release()
                    continue
                study.sampler = make_sampler(search, seed_of(study.study_name, frozen.number))
                return _claimed(search, opened.trial(frozen.number), lock)
        if len(trials) == n_trials and not any(frozen.state.name == "WAITING" for frozen in trials):
            return None
        study.sampler = make_sampler(search, seed_of(study.study_name, len(trials)))
        trial = study.ask()
        if trial.number >= n_trials:  # another machine was faster; a call with more trials takes it up
            return None
        lock = _trial_lock(folder, trial.number)
        lock.acquire()
        return _claimed(search, trial, lock)


def _claimed(search: SearchConfig, trial: "Trial", lock: FileLock) -> Claim:
    """Sample the parameters that a trial does not have yet, and record what it changes."""
    claimed = Claim(trial, lock)
    try:
        given = trial.user_attrs.get(ENQUEUED)
        chosen: dict[str, Any] = {}
        for key, dimension in in_order(search):
            name = parameter(key, dimension)
            if applies(dimension, chosen) if given is None else name in given:
                chosen[key] = to_value(dimension, suggest(trial, name, dimension))
        if CHANGES not in trial.user_attrs:
            trial.set_user_attr(CHANGES, chosen)
    except BaseException:
        claimed.release()
        raise
    return claimed


def make_sampler(search: SearchConfig, seed: int) -> "BaseSampler":
    """Return the sampler of a search; its random numbers depend on the seed alone."""
    from optuna import samplers
    from optuna.exceptions import ExperimentalWarning

    if search.sampler == "random":
        return samplers.RandomSampler(seed=seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        # `group`: parameters that conditions bring together are sampled together.
        return samplers.TPESampler(multivariate=True, group=True, constant_liar=True, seed=seed)


def seed_of(study: str, trial: int) -> int:
    """Return the seed of a trial's sampling, so that trials after a restart do not repeat those before it."""
    return zlib.crc32(f"{study} {trial}".encode())


def _trial_lock(folder: Path, number: int) -> FileLock:
    path = trial_lock_path(folder, number)
    path.parent.mkdir(parents=True, exist_ok=True)
    return FileLock(path, thread_local=False)


def _try_lock(folder: Path, number: int) -> FileLock | None:
    """Lock a trial if no process works on it, else return None."""
    lock = _trial_lock(folder, number)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return None
    return lock

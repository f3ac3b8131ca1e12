"""Checkpoints: the whole training state, written atomically, restored only if every file has its hash.

A checkpoint is a directory `step=<n>` with the model (policy, target networks, optimizers: Stable-Baselines3's zip),
the filled part of the replay buffer, counters and rollout state as JSON and arrays, the logs so far, and a manifest of
hashes. It is written under another name and renamed when all of it is on the disk. A training that is restored from it
goes on as if it had not been cut, to the last bit. Nothing in it is unpickled on restoring.
"""

import logging
import shutil
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from parking_exp.algorithms.fast.base import FastTraining
from parking_exp.algorithms.model_files import load_weights
from parking_exp.algorithms.policy_ema import PolicyEMA
from parking_exp.buffers import HerBuffer
from parking_exp.errors import DamagedFileError, DamagedModelError, ModelError
from parking_exp.runs.files import fsync, read_json, sha256, write_json
from parking_exp.runs.metric_logs import copy_logs
from parking_exp.training import rollout_state, serialization

log = logging.getLogger(__name__)

MODEL, AVERAGED, BEST = "model.zip", "averaged.zip", "best.zip"
BUFFER, MANIFEST = "replay_buffer.npz", "manifest.json"
STATE, ARRAYS, METRICS = "state.json", "state.npz", "metrics.jsonl"
COUNTERS = ("num_timesteps", "_n_updates", "_episode_num", "_current_progress_remaining")
LAST = ("_last_obs", "_last_episode_starts")
RECENT = ("ep_info_buffer", "ep_success_buffer")


@dataclass
class Progress:
    """What a run must remember besides the model and its buffer.

    Attributes:
        step: env steps so far.
        evaluated, saved: env steps at the last evaluation and checkpoint.
        best: rank of the best evaluation so far (`evaluation.rank`).
        cpu_s, wall_s: time spent so far, earlier processes included.
    """

    step: int = 0
    evaluated: int = 0
    saved: int = 0
    best: list[float] | None = None
    cpu_s: float = 0.0
    wall_s: float = 0.0


def save(
    directory: Path,
    model: OffPolicyAlgorithm,
    progress: Progress,
    best: Path,
    keep_last: int,
    average: PolicyEMA | None = None,
) -> Path:
    """Write a checkpoint, then delete all but the last `keep_last`.

    Args:
        directory: of the run's checkpoints; the logs beside it travel with each checkpoint.
        model: what is trained.
        progress: of the run.
        best: the best model's file; it travels with the checkpoint, since a later one may replace it.
        keep_last: how many whole checkpoints stay.
        average: of the policy; a second model has it.

    Raises:
        OSError: the disk is full; earlier checkpoints are untouched.
    """
    target = directory / f"step={progress.step:010d}"
    with _new_directory(target) as folder:
        model.save(folder / MODEL)
        if average is not None and average.half_life is not None:
            with average.applied():
                model.save(folder / AVERAGED)
        _save_buffer(model.replay_buffer, folder / BUFFER)
        if best.exists():
            shutil.copyfile(best, folder / BEST)
        copy_logs(directory.parent, folder)
        plain, arrays = serialization.split({"model": _attributes(model), "streams": rollout_state.get_state(model)})
        _write_arrays(folder / ARRAYS, arrays)
        write_json(folder / STATE, {"progress": asdict(progress), **plain})
    found = _found(directory)
    # What lies above this step was passed over as corrupt when the run was resumed, or it would be where we are.
    later, earlier = [f for f in found if f.name > target.name], [f for f in found if f.name < target.name]
    for stale in [*later, *earlier[: max(0, len(earlier) - keep_last + 1)]]:
        shutil.rmtree(stale)
    return target


def latest(directory: Path) -> Path | None:
    """Return the newest whole checkpoint, or None. Damaged ones are skipped."""
    for folder in reversed(_found(directory)):
        problem = check(folder)
        if problem is None:
            return folder
        log.warning("checkpoint %s is passed over (%s); trying the one before it", folder, problem)
    return None


def check(folder: Path) -> str | None:
    """Return what is wrong with a checkpoint; None if all files have their hashes."""
    try:
        manifest = read_json(folder / MANIFEST)
    except ValueError:  # not JSON, or not even text
        return f"{MANIFEST} is not readable"
    if manifest is None:
        return f"{MANIFEST} is missing"
    if not isinstance(manifest, dict):
        return f"{MANIFEST} is not readable"
    for name in (MODEL, BUFFER, STATE, ARRAYS, METRICS):
        if name not in manifest:
            return f"{MANIFEST} does not name {name}"
    for name, digest in manifest.items():
        if not (folder / name).exists():
            return f"{name} is missing"
        if sha256(folder / name) != digest:
            return f"{name} has changed"
    return None


def read_progress(folder: Path) -> Progress:
    """Read a checkpoint's progress.

    Raises:
        DamagedFileError: it has none.
    """
    try:
        return Progress(**read_json(folder / STATE)["progress"])
    except (ValueError, LookupError, TypeError) as error:
        raise DamagedFileError(f"{folder / STATE} has no progress of a run; delete {folder}") from error


def restore(folder: Path, model: OffPolicyAlgorithm, best: Path, average: PolicyEMA | None = None) -> dict[str, Any]:
    """Bring a freshly built model, the average of its policy and the best model's file to a checkpoint's state.

    Returns:
        The rollout state, for `rollout_state.set_state` when the next rollout begins.

    Raises:
        ModelError: its weights can't be loaded, although its files are as they were written.
    """
    try:
        load_weights(folder / MODEL, model)
    except DamagedModelError as error:
        raise _to_be_deleted(folder, error) from error
    except ModelError as error:
        raise ModelError(f"{error}; mend the class, or delete {folder.parents[1]} to train it afresh") from error
    if (folder / BEST).exists():
        shutil.copyfile(folder / BEST, best)
    else:
        best.unlink(missing_ok=True)
    with np.load(folder / ARRAYS, allow_pickle=False) as arrays:
        plain = {key: value for key, value in read_json(folder / STATE).items() if key != "progress"}
        state = serialization.join(plain, arrays)
    for name in (*COUNTERS, *LAST):
        setattr(model, name, state["model"][name])
    for name in RECENT:
        setattr(model, name, deque(state["model"][name], maxlen=model._stats_window_size))
    _load_buffer(model.replay_buffer, folder / BUFFER)
    if isinstance(model, FastTraining) and model._n_updates:
        model.bind()
    if average is not None and (folder / AVERAGED).exists():
        try:
            average.load(folder / AVERAGED)
        except DamagedModelError as error:
            raise _to_be_deleted(folder, error) from error
    return state["streams"]


def _to_be_deleted(folder: Path, error: DamagedModelError) -> DamagedModelError:
    return DamagedModelError(f"{error}; delete {folder} to go on from the checkpoint before it")


@contextmanager
def _new_directory(target: Path) -> Iterator[Path]:
    """Yield a directory that takes its name, with a manifest, only when all of it is on the disk."""
    target.parent.mkdir(parents=True, exist_ok=True)
    for stale in target.parent.glob(".tmp-*"):
        shutil.rmtree(stale)
    folder = target.with_name(f".tmp-{target.name}")
    folder.mkdir()
    try:
        yield folder
        files = sorted(folder.iterdir())
        for file in files:
            fsync(file)
        write_json(folder / MANIFEST, {file.name: sha256(file) for file in files})
        fsync(folder)
        if target.exists():  # the same step, found corrupt before
            shutil.rmtree(target)
        folder.rename(target)
        fsync(target.parent)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _found(directory: Path) -> list[Path]:
    return sorted(directory.glob("step=*"))


def _attributes(model: OffPolicyAlgorithm) -> dict[str, Any]:
    recent = {name: list(getattr(model, name) or ()) for name in RECENT}
    return {name: getattr(model, name) for name in (*COUNTERS, *LAST)} | recent


def _write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def _save_buffer(buffer: ReplayBuffer | None, path: Path) -> None:
    """Write the filled part of every array of a buffer, and its scalars."""
    assert buffer is not None
    if isinstance(buffer, HerBuffer):
        _write_arrays(path, buffer.get_state())
        return
    arrays: dict[str, np.ndarray] = {"pos": np.asarray(buffer.pos), "full": np.asarray(buffer.full)}
    for name, array in _arrays(buffer):
        arrays[name] = array[: buffer.size()] if len(array) == buffer.buffer_size else array
    _write_arrays(path, arrays)


def _load_buffer(buffer: ReplayBuffer | None, path: Path) -> None:
    assert buffer is not None
    with np.load(path, allow_pickle=False) as stored:
        if isinstance(buffer, HerBuffer):
            buffer.set_state(stored)
            return
        buffer.pos, buffer.full = int(stored["pos"]), bool(stored["full"])
        for name, array in _arrays(buffer):
            array[: len(stored[name])] = stored[name]


def _arrays(buffer: ReplayBuffer) -> Iterator[tuple[str, np.ndarray]]:
    """Yield every numeric array of a buffer, those in dicts under `name/key`."""
    for name, value in vars(buffer).items():
        entries = value.items() if isinstance(value, dict) else [(None, value)]
        for key, entry in entries:
            if isinstance(entry, np.ndarray) and entry.dtype != object:
                yield (name if key is None else f"{name}/{key}"), entry

"""Checkpoints: the whole training state, written atomically, restored only if all hashes match.

A checkpoint is a directory `step=<n>` with the model (policy, target networks, optimizers:
Stable-Baselines3's zip), the filled part of the replay buffer, counters and rollout state, the logs
so far, and a manifest of hashes. A training that is restored from it is bit-identical to one that
was not interrupted. Nothing is unpickled.
"""

import shutil
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.her import HerReplayBuffer

from parking_exp.algorithms.fast.fast_training import FastTraining
from parking_exp.algorithms.model_files import load_weights
from parking_exp.algorithms.policy_ema import PolicyEMA
from parking_exp.buffers import HerBuffer
from parking_exp.runs.atomic_files import fsync, replacing, write_json
from parking_exp.runs.checkpoint_files import (
    BUFFER,
    MANIFEST,
    MODEL,
    checkpoint_name,
    checkpoint_problem,
    find_checkpoints,
)
from parking_exp.runs.foreign_files import sha256
from parking_exp.runs.metric_logs import copy_logs
from parking_exp.runs.run_files import BEST_MODEL
from parking_exp.terminal import say
from parking_exp.training import rollout_state

STATE = "state.pt"
EARLIEST_ZIP_TIME = (1980, 1, 1, 0, 0, 0)
LATEST_ZIP_TIME = (2107, 12, 31, 23, 59, 58)
ATTRIBUTES = (
    "num_timesteps",
    "_n_updates",
    "_episode_num",
    "_current_progress_remaining",
    "_last_obs",
    "_last_episode_starts",
)
RECENT = ("ep_info_buffer", "ep_success_buffer")
# Pickled entries for which `SAC.load` would require an env, because of the HER buffer.
BUFFER_ENTRIES = ("replay_buffer_class", "replay_buffer_kwargs")


@dataclass
class SavedProgress:
    """Progress of a run, as a checkpoint has it."""

    step: int = 0  # env steps at the last checkpoint
    evaluated: int = 0  # env steps at the last evaluation
    best: list[float] | None = None  # rank of the best evaluation so far
    cpu_s: float = 0.0  # time spent, earlier processes included
    wall_s: float = 0.0


def save_model(model: OffPolicyAlgorithm, path: Path) -> None:
    """Save a model so that Stable-Baselines3 can load it.

    Raises:
        OSError: the disk is full; an earlier file is untouched.
    """
    with replacing(path) as temporary:
        _write_zip(model, temporary, exclude=BUFFER_ENTRIES)


def save(
    checkpoints_dir: Path,
    model: OffPolicyAlgorithm,
    policy_ema: PolicyEMA,
    progress: SavedProgress,
    best: Path,
    keep_last: int,
) -> Path:
    """Write a checkpoint, delete all but the last `keep_last`, and return its folder.

    Args:
        checkpoints_dir: the folder of checkpoints in the run directory, whose logs are copied.
        model: the model, with its replay buffer.
        policy_ema: the EMA of its actor.
        progress: the run's progress, whose step names the checkpoint.
        best: the file of the best model, which is copied if there is one.
        keep_last: the number of checkpoints to keep.

    Raises:
        OSError: the disk is full; earlier checkpoints are untouched.
    """
    target = checkpoints_dir / checkpoint_name(progress.step)
    with _new_directory(target) as folder:
        _write_zip(model, folder / MODEL)
        with (folder / BUFFER).open("wb") as file:
            np.savez(file, allow_pickle=False, **_buffer_state(model.replay_buffer))
        if best.exists():
            shutil.copyfile(best, folder / BEST_MODEL)
        copy_logs(checkpoints_dir.parent, folder)
        attributes = {name: getattr(model, name) for name in ATTRIBUTES}
        recent = {name: getattr(model, name) or () for name in RECENT}
        state = {
            "progress": asdict(progress),
            "model": attributes | recent,
            "rollout": rollout_state.get_state(model),
            "average": policy_ema.get_state(),
        }
        torch.save(to_tensors(state), folder / STATE)

    folders = find_checkpoints(checkpoints_dir)
    number = folders.index(target) + 1
    # Checkpoints of later steps were damaged when the run was resumed: delete them, too.
    for outdated in folders[: max(0, number - keep_last)] + folders[number:]:
        shutil.rmtree(outdated)
    return target


def latest(checkpoints_dir: Path) -> Path | None:
    """Return the newest intact checkpoint, or None."""
    for folder in reversed(find_checkpoints(checkpoints_dir)):
        problem = checkpoint_problem(folder)
        if problem is None:
            return folder
        say(f"warning: checkpoint {folder} is skipped ({problem})", stderr=True)
    return None


def load_state(folder: Path) -> dict[str, Any]:
    """Return what a checkpoint has beside model, buffer and logs.

    Its `progress` has the fields of `SavedProgress`.
    """
    tensors = torch.load(folder / STATE, map_location="cpu", weights_only=True)
    state: dict[str, Any] = to_arrays(tensors)
    return state


def restore(
    folder: Path, model: OffPolicyAlgorithm, policy_ema: PolicyEMA, best: Path
) -> dict[str, Any]:
    """Restore a fresh model, the EMA of its actor and the best model's file from a checkpoint.

    Returns:
        The rollout state, for `rollout_state.set_state` when the next rollout begins.
    """
    load_weights(folder / MODEL, model)
    best.unlink(missing_ok=True)
    if (folder / BEST_MODEL).exists():
        shutil.copyfile(folder / BEST_MODEL, best)

    state = load_state(folder)
    for name in ATTRIBUTES:
        setattr(model, name, state["model"][name])
    for name in RECENT:
        setattr(model, name, deque(state["model"][name], maxlen=model._stats_window_size))
    _load_buffer(model.replay_buffer, folder / BUFFER)
    if isinstance(model, FastTraining) and model._n_updates:
        model.flatten_parameters()
    policy_ema.set_state(state["average"])
    return state["rollout"]


@contextmanager
def _new_directory(target: Path) -> Iterator[Path]:
    """Yield a temporary directory; it gets its manifest and name once all of it is on disk."""
    target.parent.mkdir(parents=True, exist_ok=True)
    for leftover in target.parent.glob(".tmp-*"):  # left by a process that was killed
        shutil.rmtree(leftover)
    folder = target.with_name(f".tmp-{target.name}")
    folder.mkdir()
    try:
        yield folder
        files = sorted(folder.iterdir())
        for file in files:
            fsync(file)
        write_json(folder / MANIFEST, {file.name: sha256(file) for file in files})
        fsync(folder)
        if target.exists():  # the same step, but damaged
            shutil.rmtree(target)
        folder.rename(target)
        fsync(target.parent)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write_zip(model: OffPolicyAlgorithm, path: Path, exclude: Iterable[str] = ()) -> None:
    """Save a model with Stable-Baselines3, also where the clock is before 1980 or after 2107.

    Zip files have no other times.
    """
    now = time.localtime(time.time())
    possible = min(max(now[:6], EARLIEST_ZIP_TIME), LATEST_ZIP_TIME)
    if possible == now[:6]:
        model.save(path, exclude=exclude)
        return
    with patch("time.localtime", return_value=possible):
        model.save(path, exclude=exclude)


def _buffer_state(buffer: ReplayBuffer | None) -> dict[str, np.ndarray]:
    """Return the filled part of every array of a buffer, and its scalars."""
    assert buffer is not None
    if isinstance(buffer, HerBuffer):
        return buffer.get_state()
    state = {"pos": np.asarray(buffer.pos), "full": np.asarray(buffer.full)}
    for name, array in _arrays(buffer):
        is_by_step = len(array) == buffer.buffer_size
        state[name] = array[: buffer.size()] if is_by_step else array
    return state


def load_transitions(path: Path, buffer: ReplayBuffer | None) -> None:
    """Load the transitions of a checkpoint's replay buffer into a fresh one.

    Episodes that were under way end there.

    Raises:
        ModelError: the transitions have other fields.
    """
    if isinstance(buffer, HerBuffer):
        with np.load(path, allow_pickle=False) as stored:
            buffer.set_transitions(stored)
        return
    _load_buffer(buffer, path)
    if isinstance(buffer, HerReplayBuffer):
        buffer.truncate_last_trajectory()


def _load_buffer(buffer: ReplayBuffer | None, path: Path) -> None:
    assert buffer is not None
    with np.load(path, allow_pickle=False) as stored:
        if isinstance(buffer, HerBuffer):
            buffer.set_state(stored)
            return
        buffer.pos = int(stored["pos"])
        buffer.full = bool(stored["full"])
        for name, array in _arrays(buffer):
            array[: len(stored[name])] = stored[name]


def _arrays(buffer: ReplayBuffer) -> Iterator[tuple[str, np.ndarray]]:
    """Yield every numeric array of a buffer, those in dicts under `name/key`."""
    values: dict[str, Any] = {}
    for name, value in vars(buffer).items():
        if isinstance(value, dict):
            values |= {f"{name}/{key}": entry for key, entry in value.items()}
        else:
            values[name] = value
    for name, value in values.items():
        if isinstance(value, np.ndarray) and value.dtype != object:
            yield name, value


def to_tensors(state: Any) -> Any:
    """Return nested dicts and sequences with tensors in place of arrays.

    `torch.load(weights_only=True)` reads them.
    """
    if isinstance(state, np.ndarray | np.generic):
        return torch.from_numpy(np.array(state))
    if isinstance(state, Mapping):
        return {key: to_tensors(value) for key, value in state.items()}
    if isinstance(state, list | tuple | deque):
        return [to_tensors(value) for value in state]
    if state is None or isinstance(state, bool | int | float | str):
        return state
    raise TypeError(f"a {type(state).__name__} can't be saved without pickling it")


def to_arrays(state: Any) -> Any:
    """Return the state that `to_tensors` was given; 0-dimensional tensors become scalars."""
    if isinstance(state, torch.Tensor):
        return state.numpy()[()]
    if isinstance(state, dict):
        return {key: to_arrays(value) for key, value in state.items()}
    if isinstance(state, list):
        return [to_arrays(value) for value in state]
    return state

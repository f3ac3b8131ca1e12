"""Save and load model files: every weight comes from the file, or the file is refused.

A file is a zip as Stable-Baselines3 saves it. Its pickled part is not read, and tensors are loaded as torch's
`weights_only`: nothing in it is executed.
"""

import io
import pickle
import re
import zipfile
from collections import deque
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import recursive_getattr, recursive_setattr
from stable_baselines3.common.vec_env import VecEnv

from parking_exp.algorithms.fast.base import FastTraining
from parking_exp.errors import DamagedModelError, ModelError
from parking_exp.runs.atomic_files import replacing

VARIABLES = "pytorch_variables"
# Entries of the pickled part that a HER buffer wants an env for: without them `SAC.load(path)` is enough.
BUFFER_ENTRIES = ("replay_buffer_class", "replay_buffer_kwargs")
# What a model refers to and is not made of. Distributions hold the last sample, and gSDE's matrices, which
# `training/rollout_state.py` saves.
NOT_WEIGHTS = (gym.Env, VecEnv, BaseBuffer, BaseCallback, Logger, Distribution, torch.distributions.Distribution)
MODULE_DICTS = {"_modules", "_parameters", "_buffers"}  # of torch.nn.Module: left out of the names

# Classes that are saved and restored exactly with the networks that they make by themselves: proven by
# tests/algorithms/test_contract.py, and not checked again: `check_saving` takes 90 ms, `check_saved` 4 ms of each file.
PROVEN = {
    "parking_exp.algorithms.fast.sac.SAC",
    "parking_exp.algorithms.fast.td3.TD3",
    "parking_exp.algorithms.fast.td3.DDPG",
    "parking_exp.algorithms.crossq.CrossQ",
    "stable_baselines3.sac.sac.SAC",
    "stable_baselines3.td3.td3.TD3",
    "stable_baselines3.ddpg.ddpg.DDPG",
    "sb3_contrib.tqc.tqc.TQC",
}

Weights = Mapping[str, Any]
"""State dicts and single tensors of a model file, by the names that the model has for them."""


def save_model(model: OffPolicyAlgorithm, path: Path) -> None:
    """Save a model that Stable-Baselines3 loads anywhere.

    Raises:
        ModelError: the model has weights that the file would not hold.
        OSError: the disk is full; an earlier file is untouched.
    """
    check_saved(model)
    with replacing(path) as temporary:
        model.save(temporary, exclude=BUFFER_ENTRIES)


def load_weights(path: Path, model: OffPolicyAlgorithm) -> None:
    """Load parameters, optimizers and other tensors of a model: all of them, or none.

    Raises:
        DamagedModelError: the file can't be read, or holds something else than weights.
        ModelError: it is the file of another model, or the model has weights that no file of its holds.
        OSError: the disk fails.
    """
    weights = read_weights(path.read_bytes(), str(path), model.device)
    if problem := saving_problem(model):
        raise ModelError(f"{path} does not hold all of {class_path(type(model))}: {problem}")
    apply_weights(weights, model, str(path))


def read_weights(content: bytes, name: str, device: torch.device) -> Weights:
    """Read all tensors of a model file.

    Raises:
        DamagedModelError: bytes are missing or changed, or there is something else than weights.
    """
    if not content:
        raise DamagedModelError(f"{name} is empty")
    member = None
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _check_sums(archive)
            weights: dict[str, Any] = {}
            for member in (name for name in archive.namelist() if name.endswith(".pth")):
                file = io.BytesIO(archive.read(member))
                with zipfile.ZipFile(file) as tensors:  # torch does not look at the checksums of its own format
                    _check_sums(tensors)
                file.seek(0)
                weights[member.removesuffix(".pth")] = torch.load(file, map_location=device, weights_only=True)
            variables = dict(weights.pop(VARIABLES, None) or {})
            return weights | variables
    except Exception as error:  # damaged bytes make zipfile and torch raise anything; no disk is read here
        where = f"{name}, {member}," if member else name
        if isinstance(error, pickle.UnpicklingError) and (refused := re.search(r"GLOBAL (\S+)", str(error))):
            raise DamagedModelError(f"{where} names {refused[1]}, which is no weight, and is not loaded") from error
        words = re.split(r"\.\s|\n", str(error))[0] or type(error).__name__
        raise DamagedModelError(f"{where} is damaged ({words})") from error


def apply_weights(weights: Weights, model: OffPolicyAlgorithm, name: str) -> None:
    """Give a model all weights of a file. Nothing is changed where shapes or names do not fit.

    Raises:
        ModelError: they do not fit the model.
    """
    modules, variables = model._get_torch_save_params()
    if problem := _misfit(weights, model):
        raise ModelError(f"{name} does not fit {class_path(type(model))} as its config.yaml describes it ({problem})")
    try:
        model.set_parameters({key: weights[key] for key in modules}, device=model.device)
    except (LookupError, TypeError, ValueError, AttributeError, RuntimeError) as error:  # an optimizer's: torch checks
        raise ModelError(f"{name} does not fit {class_path(type(model))} ({str(error).splitlines()[0]})") from error
    for key in variables:
        if weights[key] is not None:
            recursive_setattr(model, f"{key}.data", weights[key].data)


def check_saved(model: OffPolicyAlgorithm) -> None:
    """Refuse to save a model with weights that its files do not hold, such as those that its `train` has made.

    Raises:
        ModelError: it has such weights.
    """
    if class_path(type(model)) not in PROVEN and (problem := saving_problem(model)):
        raise ModelError(f"{class_path(type(model))} can't be saved and restored exactly: {problem}")


def class_path(algorithm: type) -> str:
    """Return the dotted path of a class, where it is defined."""
    return f"{algorithm.__module__}.{algorithm.__qualname__}"


def saving_problem(model: OffPolicyAlgorithm) -> str | None:
    """Name the tensors and optimizers that a model keeps and its files do not hold; return None if they hold all."""
    saved = set()
    for _, one in _saved(model):
        saved |= {_key(part) for part in (_state(one).values() if isinstance(one, torch.nn.Module) else [one])}
    if not saved:
        return "its _get_torch_save_params() names no weights"
    names = [name for name, one in reachable(model) if _key(one) not in saved]
    return f"{_some(names)} would be lost; its _get_torch_save_params() must name what holds them" if names else None


def reachable(model: OffPolicyAlgorithm) -> Iterator[tuple[str, torch.Tensor | torch.optim.Optimizer]]:
    """Yield every tensor and optimizer that a model's attributes lead to, with its name."""
    # Of the fast classes: rebuilt from the weights whenever these are replaced.
    own = {"_update"} if isinstance(model, FastTraining) else set()
    yield from _walk({name: value for name, value in vars(model).items() if name not in own}, "", set())


def _walk(node: Any, name: str, seen: set[int]) -> Iterator[tuple[str, Any]]:
    if id(node) in seen or isinstance(node, (*NOT_WEIGHTS, type)):
        return
    seen.add(id(node))
    if isinstance(node, torch.optim.Optimizer) or (isinstance(node, torch.Tensor) and node.numel()):
        yield name, node
        return
    children: list[tuple[Any, Any]] = list(vars(node).items()) if hasattr(node, "__dict__") else []
    if isinstance(node, Mapping):
        children += node.items()
    elif isinstance(node, list | tuple | set | frozenset | deque):
        children += enumerate(node)
    for key, child in children:
        part = "" if key in MODULE_DICTS else f".{key}"
        yield from _walk(child, f"{name}{part}".lstrip("."), seen)


def _check_sums(archive: zipfile.ZipFile) -> None:
    if (member := archive.testzip()) is not None:
        raise zipfile.BadZipFile(f"the checksum of {member} is wrong")


def _saved(model: OffPolicyAlgorithm) -> Iterator[tuple[str, Any]]:
    """Yield what a model's files hold: modules, optimizers and tensors."""
    for name in chain(*model._get_torch_save_params()):
        try:
            yield name, recursive_getattr(model, name)
        except AttributeError as error:
            algorithm = class_path(type(model))
            raise ModelError(f"{algorithm} has no {name}, which its _get_torch_save_params() names") from error


def _misfit(weights: Weights, model: OffPolicyAlgorithm) -> str | None:
    """Say in what a file's weights differ from a model's: names, shapes, types."""
    saved = dict(_saved(model))
    lacks, odd = sorted(set(saved) - set(weights)), sorted(set(weights) - set(saved))
    if lacks or odd:
        return " and ".join([f"it lacks {_some(lacks)}"] * bool(lacks) + [f"it has {_some(odd)} besides"] * bool(odd))
    for name, one in saved.items():
        ours, found = {"": one}, {"": weights[name]}
        if hasattr(one, "state_dict"):
            ours, found = one.state_dict(), weights[name]
        if not isinstance(found, Mapping):
            return f"{name} is {_describe(found)}, and not a dict"
        if different := set(ours) ^ set(found):
            return f"{name} has other parameters ({_some(sorted(map(str, different)))})"
        for key, value in ours.items():
            if _describe(value) != _describe(found[key]):
                return f"{name}.{key}".rstrip(".") + f" is {_describe(found[key])}, and not {_describe(value)}"
    return None


def _state(module: torch.nn.Module) -> dict[str, torch.Tensor]:
    state = module.state_dict(keep_vars=True)
    return {name: value for name, value in state.items() if isinstance(value, torch.Tensor)}


def _key(one: Any) -> Any:
    """Return what two names of the same memory have in common."""
    return (one.data_ptr(), one.shape, one.stride()) if isinstance(one, torch.Tensor) else id(one)


def _describe(value: Any) -> str:
    if not isinstance(value, torch.Tensor):
        return f"a {type(value).__name__}"
    return f"{str(value.dtype).removeprefix('torch.')} of shape {list(value.shape)}"


def _some(names: list[str]) -> str:
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")

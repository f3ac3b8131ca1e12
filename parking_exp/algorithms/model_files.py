"""Load model files: zips as Stable-Baselines3 saves them.

The pickled part of a file is not read, and tensors are loaded as torch's `weights_only`: nothing in
it is executed.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import load_from_zip_file, recursive_getattr

from parking_exp.algorithms.policy_files import ACTOR_PREFIX, load_layers
from parking_exp.errors import ModelError, one_line

LOG_ENT_COEF = "log_ent_coef"  # in SAC, TQC and CrossQ; None if it is not tuned


def load_weights(path: Path, model: OffPolicyAlgorithm) -> None:
    """Load all parameters, optimizers and other tensors of a model.

    Raises:
        ModelError: the file is damaged, holds something other than weights, or belongs to another
            model; some weights may have been loaded by then.
    """
    weights, variables = read_weights(path, model.device)
    _, names = model._get_torch_save_params()
    try:
        if variables.keys() != set(names):
            raise ValueError(f"it has the tensors {sorted(variables)}, not {sorted(names)}")
        model.set_parameters(weights, device=model.device)
        for name in names:
            recursive_getattr(model, name).data.copy_(variables[name])
    except (LookupError, TypeError, ValueError, RuntimeError) as error:
        problem = one_line("".join(str(error).splitlines()[:2]))
        raise ModelError(
            f"{path} does not fit {type(model).__name__} as its config.yaml describes it: {problem}"
        ) from error


def load_networks(path: Path, model: OffPolicyAlgorithm) -> None:
    """Load all networks of a model, and the entropy coefficient if the file has a tuned one.

    Optimizers, and an entropy coefficient that is not tuned, are left as they are.

    Raises:
        ModelError: the file is damaged, or its networks have other layers.
    """
    weights, variables = read_weights(path, model.device)
    load_layers(model.policy, weights.get("policy", {}), path)
    coefficient = getattr(model, LOG_ENT_COEF, None)
    if coefficient is not None and LOG_ENT_COEF in variables:
        coefficient.data.copy_(variables[LOG_ENT_COEF])


def load_actor(path: Path, model: OffPolicyAlgorithm) -> None:
    """Load only the actor of a model file; nothing else in the file has to fit.

    Raises:
        ModelError: the file is damaged, or has another actor.
    """
    actor = model.policy.get_submodule("actor")
    weights = read_actor(path, model.device)
    hint = (
        "; name the env that it was trained on (env=NAME), and its algorithm and policy "
        "(algorithm=NAME algorithm.policy_kwargs.NAME=VALUE)"
    )
    load_layers(actor, weights, path, prefix=ACTOR_PREFIX, hint=hint)


def read_actor(path: Path, device: torch.device | str) -> dict[str, torch.Tensor]:
    """Return the weights of the actor in a model file, by name.

    Raises:
        ModelError: see `read_weights`.
    """
    weights, _ = read_weights(path, device)
    policy = weights.get("policy")
    actor: dict[str, torch.Tensor] = {}
    if not isinstance(policy, Mapping):
        return actor
    for name, weight in policy.items():
        if str(name).startswith(ACTOR_PREFIX) and isinstance(weight, torch.Tensor):
            actor[name.removeprefix(ACTOR_PREFIX)] = weight
    return actor


def read_weights(path: Path, device: torch.device | str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return all state dicts of a model file, and its single tensors, both by name.

    Raises:
        ModelError: it is not a file, is damaged, or holds something other than weights.
    """
    if not path.is_file():
        raise ModelError(f"{path} is not a file")
    with path.open("rb") as file:
        try:
            _, weights, variables = load_from_zip_file(file, load_data=False, device=device)
        except Exception as error:  # damaged bytes make zipfile and torch raise anything
            reason = re.split(r"\.\s|\n", str(error))[0] or type(error).__name__
            raise ModelError(f"{path} is damaged ({reason})") from error
    return weights, variables or {}

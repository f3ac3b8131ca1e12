"""Save and load an actor's weights as safetensors: nothing in such a file can be executed.

Policies of different classes can have weights of the same names and shapes, so the file's metadata
names the classes of the policy and of its features extractor.
"""

from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from parking_exp.algorithms.policy_ema import ACTOR
from parking_exp.errors import ModelError
from parking_exp.runs.atomic_files import replacing


def save_policy(model: OffPolicyAlgorithm, path: Path) -> None:
    """Save the weights of a model's actor.

    Raises:
        ModelError: the model's policy has no actor.
        OSError: the file cannot be written; an earlier one is untouched.
    """
    weights = {name: weight.contiguous() for name, weight in _actor(model).items()}
    with replacing(path) as temporary:
        temporary.write_bytes(save(weights, metadata={"format": "pt", **_classes(model)}))


def load_policy(path: Path, model: OffPolicyAlgorithm) -> None:
    """Give a model's actor the weights of a file, all of them or none; its critics stay as they
    are.

    Raises:
        ModelError: the file cannot be read, or is the actor of another model.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (it has no items)
    except SafetensorError as error:
        raise ModelError(f"{path} is damaged ({error})") from error
    actor = _actor(model)
    for part, name in _classes(model).items():
        if metadata.get(part, name) != name:
            raise ModelError(
                f"{path} has the weights of another policy: its {part} is {metadata[part]}, not "
                f"{name}"
            )
    formats, expected = (
        {name: (tensor.dtype, tensor.shape) for name, tensor in tensors.items()}
        for tensors in (weights, actor)
    )
    if different := [
        name for name in expected | formats if formats.get(name) != expected.get(name)
    ]:
        raise ModelError(f"{path} does not fit this {type(model).__name__}: {different[0]} differs")
    for name, weight in actor.items():
        weight.copy_(weights[name])


def _actor(model: OffPolicyAlgorithm) -> dict[str, torch.Tensor]:
    weights = {
        name: weight for name, weight in model.policy.state_dict().items() if name.startswith(ACTOR)
    }
    if not weights:
        raise ModelError(f"{type(model).__name__} has no actor")
    return weights


def _classes(model: OffPolicyAlgorithm) -> dict[str, str]:
    features = getattr(model.policy.actor, "features_extractor", None)
    return {"policy": type(model.policy).__name__, "features extractor": type(features).__name__}

"""Save and load the weights of actors and critics as safetensors, which can execute nothing.

Policies of different classes can have weights of the same names and shapes, so the file's metadata
names the classes of the policy and of its features extractor.
"""

from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from torch import nn

from parking_exp.errors import ModelError

ACTOR_PREFIX = "actor."  # prefix of the names of the actor's weights in a policy
NETWORKS = ("actor", "critic")


def export_safetensors(model: OffPolicyAlgorithm) -> bytes:
    """Return a file with the weights of a model's actor and critics, without their targets."""
    weights = {}
    for name, weight in model.policy.state_dict().items():
        network, _, _ = name.partition(".")
        if network in NETWORKS:
            # A copy, since actor and critics may share a features extractor.
            weights[name] = weight.clone(memory_format=torch.contiguous_format)
    return save(weights, metadata=_metadata(model))


def load_policy(path: Path, model: OffPolicyAlgorithm) -> None:
    """Give a model's actor and critics, and their targets, the weights of a file.

    The critics stay as they are if the file has none.

    Raises:
        ModelError: the file is damaged, or has the networks of another model.
    """
    networks: dict[str, dict[str, torch.Tensor]] = {"actor": {}}
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata()
            for name in file.keys():  # noqa: SIM118 (it has no items)
                network, _, layer = name.partition(".")
                networks.setdefault(network, {})[layer] = file.get_tensor(name)
    except SafetensorError as error:
        raise ModelError(f"{path} is damaged ({error})") from error

    if metadata != _metadata(model):
        raise ModelError(f"{path} is of another policy: {metadata}, not {_metadata(model)}")
    others = [network for network in networks if network not in NETWORKS]
    if others:
        raise ModelError(f"{path} does not fit: it has a network {others[0]!r}")
    for network in NETWORKS:
        if network not in networks:
            continue
        for name in (network, f"{network}_target"):
            module = getattr(model.policy, name, None)
            if module is not None:
                load_layers(module, networks[network], path, prefix=f"{network}.")


def load_layers(
    network: nn.Module,
    weights: Mapping[str, torch.Tensor],
    path: Path,
    *,
    prefix: str = "",
    hint: str = "; observations, actions and networks have to be as large as in its training",
) -> None:
    """Load weights of a file into a network.

    Args:
        network: the network, whose layers are named without the prefix.
        weights: the weights by layer.
        path: the path of the file, for the message.
        prefix: the beginning of the names of layers in the message.
        hint: the end of the message.

    Raises:
        ModelError: a layer is missing or has another shape, or there is one too many.
    """
    model_weights = network.state_dict()
    for name in [*model_weights, *weights]:
        stored = _describe(weights.get(name))
        expected = _describe(model_weights.get(name))
        if stored != expected:
            raise ModelError(
                f"{path} does not fit: its layer {prefix}{name} {stored}, and the model's "
                f"{expected}{hint}"
            )
    network.load_state_dict(weights)


def _describe(weight: torch.Tensor | None) -> str:
    """Say how large a layer is."""
    if weight is None:
        return "is missing"
    if weight.ndim == 2:
        n_units, n_inputs = weight.shape
        return f"has {n_inputs} inputs and {n_units} units"
    return f"has the shape {tuple(weight.shape)}"


def _metadata(model: OffPolicyAlgorithm) -> dict[str, str]:
    features = model.policy.get_submodule("actor.features_extractor")
    return {
        "format": "pt",
        "policy": type(model.policy).__name__,
        "features extractor": type(features).__name__,
    }

"""Export a policy to files that other programs read: ONNX, TorchScript, or the actor's weights as safetensors.

An exported policy takes the env's Dict observation and gives the action that `predict(deterministic=True)` gives:
features, mirroring, and the scale of the actions are inside.
"""

import copy
import inspect
import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import Distribution
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy

from parking_exp.algorithms.model_files import class_path
from parking_exp.algorithms.policy_files import load_policy, save_policy
from parking_exp.envs.interface import Observation, Policy
from parking_exp.errors import ModelError
from parking_exp.runs.atomic_files import replacing

TOLERANCE = 1e-4  # between a file's actions and the model's; torch's own differ by 6e-6 between two batch sizes
OPSET = 17  # of ONNX: what onnxruntime reads since 1.13
ACTION = "action"


class PolicyModule(torch.nn.Module):
    """A deterministic policy as one module: from the Dict observation to actions as `env.step` takes them, float32."""

    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, policy: BasePolicy) -> None:
        super().__init__()
        assert isinstance(policy.action_space, spaces.Box)
        self.policy = policy
        self.names = list(_input_shapes(policy))
        self.register_buffer("low", torch.as_tensor(policy.action_space.low))
        self.register_buffer("high", torch.as_tensor(policy.action_space.high))

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return actions, shape (batch, actions), for observations of shape (batch, features) each."""
        actions = self.policy(observation, deterministic=True)
        if self.policy.squash_output:
            return self.low + 0.5 * (actions + 1.0) * (self.high - self.low)
        return torch.clamp(actions, self.low, self.high)


class _Positional(torch.nn.Module):
    """A policy module whose entries of the observation are inputs of their own, as ONNX has them."""

    def __init__(self, module: PolicyModule) -> None:
        super().__init__()
        self.module = module

    def forward(self, *entries: torch.Tensor) -> torch.Tensor:
        return self.module(dict(zip(self.module.names, entries, strict=True)))


def export_policy(model: OffPolicyAlgorithm, file_format: str, path: Path, observations: Observation) -> float:
    """Write a model's policy to a file, read it back, and return the largest difference of its actions.

    Args:
        model: what is exported, on the CPU.
        file_format: `onnx`, `torchscript` or `safetensors`.
        path: the file; one that is there is replaced once the new one is checked.
        observations: on which actions are compared; of shape (batch, features) each.

    Raises:
        ModelError: the policy can't be exported, or what was written gives other actions; no file is left behind.
        OSError: the file can't be written.
    """
    if not isinstance(model.policy, BasePolicy) or not isinstance(model.observation_space, spaces.Dict):
        raise ModelError(f"{class_path(type(model))} can't be exported: its policy is no torch policy for goals")
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        try:
            WRITERS[file_format](model, temporary)
            return check_actions(READERS[file_format](temporary, model), model, observations, str(path))
        except (ModelError, OSError):
            raise
        except Exception as error:  # an exporter may raise anything of a policy that nobody here has seen
            words = (str(error).splitlines() or [""])[0] or type(error).__name__
            kind = class_path(type(model.policy))
            raise ModelError(f"the policy {kind} can't be exported as {file_format}: {words}") from error


def check_actions(exported: Policy, model: OffPolicyAlgorithm, observations: Observation, name: str) -> float:
    """Return the largest difference of an exported policy's actions from the model's; `name` is for errors.

    Raises:
        ModelError: it is above `TOLERANCE`.
    """
    expected, _ = model.predict(observations, deterministic=True)
    difference = float(np.abs(exported(observations) - expected).max())
    if not difference <= TOLERANCE:  # NaN, too
        raise ModelError(
            f"{name}: the exported policy's actions differ from the model's by {difference:.2g}, and "
            f"{TOLERANCE:g} is allowed; nothing is written"
        )
    return difference


def write_onnx(model: OffPolicyAlgorithm, path: Path) -> None:
    """Write a model's policy as ONNX: an input for each entry of the observation, and `action`; any batch size."""
    import onnx

    module = PolicyModule(model.policy).eval()
    entries = _example(model.policy)
    # The newer exporter takes 20 s, prints what it does, and writes weights into a file of their own.
    older: dict[str, Any] = {"dynamo": False} if "dynamo" in inspect.signature(torch.onnx.export).parameters else {}
    batch = {name: {0: "batch"} for name in (*entries, ACTION)}
    with _quiet():
        torch.onnx.export(
            _Positional(module),
            tuple(entries.values()),
            path,
            input_names=list(entries),
            output_names=[ACTION],
            dynamic_axes=batch,
            opset_version=OPSET,
            **older,
        )
    graph = onnx.load(path)
    # Entries that the policy does not look at have vanished; whole observations are fed.
    del graph.graph.input[:]
    for name, shape in _input_shapes(model.policy).items():
        graph.graph.input.append(onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["batch", *shape]))
    for node in graph.graph.node:
        node.ClearField("doc_string")  # where in Python it comes from: paths of this machine
    onnx.checker.check_model(graph)
    path.write_bytes(graph.SerializeToString())


def read_onnx(path: Path, model: OffPolicyAlgorithm) -> Policy:
    """Return the policy of an ONNX file."""
    import onnxruntime  # type: ignore[import-untyped]

    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    return lambda observation: session.run([ACTION], _single(observation))[0]


def write_torchscript(model: OffPolicyAlgorithm, path: Path) -> None:
    """Write a model's policy as TorchScript: a module that takes a dict of tensors."""
    module, written = PolicyModule(model.policy).eval(), io.BytesIO()
    with _quiet(), torch.no_grad():
        traced = torch.jit.trace(module, (_example(model.policy),), check_trace=False)
        torch.jit.save(torch.jit.freeze(traced), written)  # frozen, it has no critics
    path.write_bytes(written.getvalue())  # torch refuses names such as `.policy`


def read_torchscript(path: Path, model: OffPolicyAlgorithm) -> Policy:
    """Return the policy of a TorchScript file."""
    with _quiet():
        module = torch.jit.load(path, map_location="cpu")

    def policy(observation: Observation) -> np.ndarray:
        with torch.no_grad():
            return module({name: torch.as_tensor(value) for name, value in _single(observation).items()}).numpy()

    return policy


def read_safetensors(path: Path, model: OffPolicyAlgorithm) -> Policy:
    """Return the policy of a model like this one, with other weights until it has those of the file."""
    other = copy.copy(model)
    other.policy = _copied(model.policy)
    with torch.no_grad():
        for weight in other.policy.state_dict().values():
            weight.zero_()
    load_policy(path, other)
    return lambda observation: other.predict(observation, deterministic=True)[0]


WRITERS: dict[str, Callable[[OffPolicyAlgorithm, Path], None]] = {
    "onnx": write_onnx,
    "torchscript": write_torchscript,
    "safetensors": save_policy,
}
READERS: dict[str, Callable[[Path, OffPolicyAlgorithm], Policy]] = {
    "onnx": read_onnx,
    "torchscript": read_torchscript,
    "safetensors": read_safetensors,
}


@contextmanager
def _quiet() -> Iterator[None]:
    """Say nothing of what torch's exporters warn about: that they are old, and of checks that tracing passes by."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _copied(policy: BasePolicy) -> BasePolicy:
    """Return a copy of a policy with weights of its own."""
    # Distributions hold the last sample, or gSDE's matrices, which torch does not copy with their gradients.
    parts = [part for module in policy.modules() for part in vars(module).values()]
    memo = {id(part): copy.copy(part) for part in parts if isinstance(part, Distribution)}
    return copy.deepcopy(policy, memo)


def _input_shapes(policy: BasePolicy) -> dict[str, tuple[int, ...]]:
    space = policy.observation_space
    assert isinstance(space, spaces.Dict)
    return {name: tuple(box.shape or ()) for name, box in space.items()}


def _example(policy: BasePolicy) -> dict[str, torch.Tensor]:
    """Return an observation to trace with; no value in it is special."""
    return {name: torch.rand(2, *shape) for name, shape in _input_shapes(policy).items()}


def _single(observation: Observation) -> Observation:
    return {name: np.asarray(value, np.float32) for name, value in observation.items()}

"""Export a policy to files that other programs read: ONNX, TorchScript, or the actor's weights as safetensors.

An exported policy takes the env's Dict observation and gives the action that `predict(deterministic=True)` gives:
features, mirroring, and the scale of the actions are inside.
"""

import io
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy

from parking_exp.algorithms.policy_files import load_policy, save_policy
from parking_exp.errors import ModelError
from parking_exp.runs.atomic_files import replacing
from parking_exp.tasks.task import Observation

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
        self.register_buffer("low", torch.as_tensor(policy.action_space.low))
        self.register_buffer("high", torch.as_tensor(policy.action_space.high))

    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return actions, shape (batch, actions), for observations of shape (batch, features) each."""
        actions = self.policy(observation, deterministic=True)
        if self.policy.squash_output:
            return self.low + 0.5 * (actions + 1.0) * (self.high - self.low)
        return torch.clamp(actions, self.low, self.high)


class PositionalPolicyModule(PolicyModule):
    """The same with an input for each entry of the observation, in order of their names, as ONNX has them."""

    def forward(self, *entries: torch.Tensor) -> torch.Tensor:  # type: ignore[override]
        """Return actions, shape (batch, actions)."""
        return super().forward(dict(zip(self.policy.observation_space.keys(), entries, strict=True)))


def export_policy(model: OffPolicyAlgorithm, file_format: str, path: Path, observations: Observation) -> float:
    """Write a model's policy to a file, read it back, and return the largest difference of its actions.

    Args:
        model: what is exported, on the CPU.
        file_format: `onnx`, `torchscript` or `safetensors`.
        path: the file; one that is there is replaced once the new one is checked.
        observations: on which actions are compared; of shape (batch, features) each.

    Raises:
        ModelError: the file's actions differ from the model's by more than `TOLERANCE`; nothing is written.
        OSError: the file cannot be written.
    """
    expected, _ = model.predict(observations, deterministic=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch's exporters warn that they are old, and of checks that tracing skips
        actions = EXPORTERS[file_format](model, temporary, observations)
        difference = float(np.abs(actions - expected).max())
        if not difference <= TOLERANCE:  # NaN, too
            raise ModelError(f"{path} is not written: its actions differ from the model's by {difference:.2g}")
    return difference


def _export_onnx(model: OffPolicyAlgorithm, path: Path, observations: Observation) -> np.ndarray:
    """Write ONNX with an input for each entry of the observation, and `action`, for any batch size."""
    import onnx
    import onnxruntime  # type: ignore[import-untyped]

    example = _example(model)
    # The newer exporter takes 20 s, prints what it does, and writes weights into a file of their own.
    torch.onnx.export(
        PositionalPolicyModule(model.policy).eval(),
        tuple(example.values()),
        path,
        input_names=list(example),
        output_names=[ACTION],
        dynamic_axes={name: {0: "batch"} for name in (*example, ACTION)},
        opset_version=OPSET,
        dynamo=False,
    )
    graph = onnx.load(path)
    # Entries that the policy does not look at have vanished; whole observations are fed.
    del graph.graph.input[:]
    for name, tensor in example.items():
        shape = ["batch", *tensor.shape[1:]]
        graph.graph.input.append(onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape))
    for node in graph.graph.node:
        node.ClearField("doc_string")  # where in Python it comes from: paths of this machine
    onnx.checker.check_model(graph)
    path.write_bytes(graph.SerializeToString())
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    return session.run([ACTION], _float32(observations))[0]


def _export_torchscript(model: OffPolicyAlgorithm, path: Path, observations: Observation) -> np.ndarray:
    """Write TorchScript: a module that takes a dict of tensors."""
    file = io.BytesIO()
    with torch.no_grad():
        traced = torch.jit.trace(PolicyModule(model.policy).eval(), (_example(model),), check_trace=False)
        torch.jit.save(torch.jit.freeze(traced), file)  # frozen, it has no critics
        path.write_bytes(file.getvalue())  # torch refuses names such as `.policy`
        policy = torch.jit.load(path, map_location="cpu")
        return policy({name: torch.as_tensor(value) for name, value in _float32(observations).items()}).numpy()


def _export_safetensors(model: OffPolicyAlgorithm, path: Path, observations: Observation) -> np.ndarray:
    """Write the actor's weights as safetensors."""
    save_policy(model, path)
    load_policy(path, model)
    return model.predict(observations, deterministic=True)[0]


EXPORTERS: dict[str, Callable[[OffPolicyAlgorithm, Path, Observation], np.ndarray]] = {
    "onnx": _export_onnx,
    "torchscript": _export_torchscript,
    "safetensors": _export_safetensors,
}
"""Functions that write a file, read it back, and return its actions on some observations."""


def _example(model: OffPolicyAlgorithm) -> dict[str, torch.Tensor]:
    """Return an observation to trace with; no value in it is special."""
    assert isinstance(model.observation_space, spaces.Dict)
    return {name: torch.rand(2, *(box.shape or ())) for name, box in model.observation_space.items()}


def _float32(observations: Observation) -> Observation:
    return {name: np.asarray(value, np.float32) for name, value in observations.items()}

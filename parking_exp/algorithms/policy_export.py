"""Export a policy as ONNX.

The file takes the env's Dict observation and gives the action that `predict(deterministic=True)`
gives: features, mirroring, and the scale of the actions are inside.
"""

import os
import warnings
from pathlib import Path

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy

from parking_exp.errors import ModelError
from parking_exp.runs.atomic_files import replacing

# between a file's actions and the model's; torch's own differ by 6e-6 between two batch sizes
TOLERANCE = 1e-4
OPSET = 17  # of ONNX: what onnxruntime reads since 1.13
ACTION = "action"


class PolicyModule(torch.nn.Module):
    """A deterministic policy with an input for each entry of the observation, in order of their
    names.
    """

    low: torch.Tensor
    high: torch.Tensor

    def __init__(self, policy: BasePolicy) -> None:
        super().__init__()
        assert isinstance(policy.action_space, spaces.Box)
        self.policy = policy
        self.register_buffer("low", torch.as_tensor(policy.action_space.low))
        self.register_buffer("high", torch.as_tensor(policy.action_space.high))

    def forward(self, *entries: torch.Tensor) -> torch.Tensor:
        """Return actions as `env.step` takes them, shape (batch, actions), for entries of shape
        (batch, size) each.
        """
        observation = dict(zip(self.policy.observation_space.keys(), entries, strict=True))
        actions = self.policy(observation, deterministic=True)
        if self.policy.squash_output:
            return self.low + 0.5 * (actions + 1.0) * (self.high - self.low)
        return torch.clamp(actions, self.low, self.high)


def export_onnx(model: OffPolicyAlgorithm, path: Path) -> None:
    """Write a model's policy, which is on the CPU, as ONNX: an input for each entry of the
    observation, and `action`.

    Raises:
        ModelError: the file's actions on random observations differ from the model's; nothing is
            written.
        OSError: the file cannot be written.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # read at the import: nothing leaves the machine
    import onnx
    import onnxruntime  # type: ignore[import-untyped]

    assert isinstance(model.observation_space, spaces.Dict)
    rng, boxes = np.random.default_rng(0), model.observation_space.items()
    observations = {
        name: rng.standard_normal((64, *(box.shape or ())), np.float32) for name, box in boxes
    }
    with replacing(path) as temporary, warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # the exporter warns that it is old, and of checks that tracing skips
        # The newer exporter takes 20 s, prints what it does, and writes weights into a file of
        # their own.
        torch.onnx.export(
            PolicyModule(model.policy).eval(),
            tuple(torch.as_tensor(value) for value in observations.values()),
            temporary,
            input_names=list(observations),
            output_names=[ACTION],
            dynamic_axes={name: {0: "batch"} for name in (*observations, ACTION)},
            opset_version=OPSET,
            dynamo=False,
        )
        graph = onnx.load(temporary)
        # Restore the inputs that the exporter dropped because the policy does not use them.
        del graph.graph.input[:]
        for name, value in observations.items():
            shape = ["batch", *value.shape[1:]]
            graph.graph.input.append(
                onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)
            )
        for node in graph.graph.node:
            node.ClearField("doc_string")  # where in Python it comes from: paths of this machine
        content = graph.SerializeToString()
        session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
        expected, _ = model.predict(observations, deterministic=True)
        if (
            not np.abs(session.run([ACTION], observations)[0] - expected).max() <= TOLERANCE
        ):  # NaN, too
            raise ModelError(f"{path} is not written: its actions differ from the model's")
        temporary.write_bytes(content)

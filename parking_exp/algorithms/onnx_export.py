"""Export a policy as ONNX.

The file maps the env's Dict observation to the action of `predict(deterministic=True)`. It includes
features, mirroring and the scaling of actions.
"""

import os
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy

from parking_exp.errors import ModelError

# How far a file's actions may be from the model's, which vary by 6e-6 with the batch size.
TOLERANCE = 1e-4
OPSET = 17  # onnxruntime has read it since 1.13
ACTION = "action"


class PolicyModule(torch.nn.Module):
    """A deterministic policy with an input for each entry of the observation, sorted by name."""

    def __init__(self, policy: BasePolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, *entries: torch.Tensor) -> torch.Tensor:
        """Return actions as `env.step` takes them, shape (batch, actions).

        Each entry has the shape (batch, size).
        """
        assert isinstance(self.policy.action_space, spaces.Box)
        low = torch.as_tensor(self.policy.action_space.low)
        high = torch.as_tensor(self.policy.action_space.high)
        observation = dict(zip(self.policy.observation_space.keys(), entries, strict=True))
        actions = self.policy(observation, deterministic=True)  # in [-1, 1]
        return low + 0.5 * (actions + 1.0) * (high - low)


def export_onnx(model: OffPolicyAlgorithm) -> bytes:
    """Return the policy of a model on the CPU as an ONNX file.

    It has an input for each entry of the observation, and the output `action`.

    Raises:
        ModelError: the file's actions on random observations differ from the model's.
    """
    os.environ["ORT_DISABLE_TELEMETRY"] = "1"  # read at the import: nothing leaves the machine
    import onnx
    import onnxruntime  # type: ignore[import-untyped]

    assert isinstance(model.observation_space, spaces.Dict)
    rng = np.random.default_rng(0)
    observations = {}
    for name, box in model.observation_space.items():
        observations[name] = rng.standard_normal((64, *(box.shape or ())), np.float32)

    with TemporaryDirectory() as folder, warnings.catch_warnings():
        file = Path(folder) / "policy.onnx"
        # The exporter warns that it is old, and of checks that tracing skips. The newer one takes
        # 20 s and prints what it does.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            PolicyModule(model.policy).eval(),
            tuple(torch.as_tensor(value) for value in observations.values()),
            file,
            input_names=list(observations),
            output_names=[ACTION],
            dynamic_axes={name: {0: "batch"} for name in [*observations, ACTION]},
            opset_version=OPSET,
            dynamo=False,
        )
        onnx_model = onnx.load(file)

    # Restore the inputs that the exporter dropped because the policy does not use them.
    del onnx_model.graph.input[:]
    for name, value in observations.items():
        shape = ["batch", *value.shape[1:]]
        info = onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)
        onnx_model.graph.input.append(info)
    for node in onnx_model.graph.node:
        node.ClearField("doc_string")  # where in Python it comes from: paths of this machine
    content = onnx_model.SerializeToString()

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    (actions,) = session.run([ACTION], observations)
    expected, _ = model.predict(observations, deterministic=True)
    if not np.allclose(actions, expected, rtol=0, atol=TOLERANCE):
        raise ModelError("nothing is written: the ONNX file's actions differ from the model's")
    return content

"""Export the policy of a stored run, or of a pretrained agent, to a file that other programs read."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config.paths import directory_path
from parking_exp.config.validate import parse
from parking_exp.errors import ConfigError
from parking_exp.evaluation.agents import AgentRequest
from parking_exp.tasks.registry import make_task
from parking_exp.terminal import say

if TYPE_CHECKING:
    import numpy as np

    from parking_exp.tasks.task import Observation, Policy, Task

N_OBSERVATIONS = 1000  # on which a file is compared with the model
N_EPISODES = 50  # that they come from
RANDOM_FRACTION = 0.1  # of actions, so that the file is also compared where the policy would not go
SUFFIXES = {"onnx": ".onnx", "torchscript": ".pt", "safetensors": ".safetensors"}


class ExportRequest(AgentRequest):
    """The config of scripts/export.py."""

    format: Literal["onnx", "torchscript", "safetensors"]
    path: Annotated[str, Field(min_length=1)] | None


def validate_request(config: DictConfig) -> ExportRequest:
    """Validate a composed config."""
    request = parse(ExportRequest, config)
    for name in ("onnx", "onnxruntime") if request.format == "onnx" else ():
        if find_spec(name) is None:
            raise ConfigError(f"format={request.format}: {name} is not installed; pip install 'parking-exp[export]'")
    suffix = SUFFIXES[request.format]
    if request.path is not None and not request.path.endswith(suffix):
        raise ConfigError(f"path={request.path}: a file of format={request.format} ends in {suffix}")
    return request


def export_run(config: DictConfig) -> Path:
    """Write the policy, compare the file with the model, print the largest difference; return the file's path.

    Raises:
        ConfigError: the config is not valid; also what `agents.load_model` raises.
        ModelError: the model can't be exported, or the file's actions differ from the model's.
    """
    request = validate_request(config)
    agent = request.agent()
    # Files are for any machine, and are compared with what the CPU computes.
    agent = replace(agent, config=agent.config.model_copy(update={"device": "cpu"}))
    path = agent.folder / "exports" / f"policy{SUFFIXES[request.format]}"
    if request.path is not None:
        path = directory_path(request.path)
    if agent.directory is not None:
        say(f"run directory  {agent.directory.path}")

    from parking_exp.algorithms.build_model import greedy_policy
    from parking_exp.algorithms.policy_export import TOLERANCE, export_policy

    model = agent.model(agent.config.env)
    observations = sample_observations(greedy_policy(model), make_task(agent.config.env), N_OBSERVATIONS)
    difference = export_policy(model, request.format, path, observations)
    say(
        f"exported       {agent.name} as {request.format}, {path.stat().st_size / 1000:.1f} kB",
        f"checked        on {N_OBSERVATIONS:,} observations: largest difference from torch {difference:.1e} "
        f"({TOLERANCE:g} is allowed)",
        f"file           {path}",
    )
    return path


def sample_observations(policy: "Policy", task: "Task", number: int) -> "Observation":
    """Return observations of whole episodes of a policy, with some random actions; the same at each call.

    They are evenly drawn, from the episodes' first steps to their last.
    """
    import numpy as np

    from parking_exp.evaluation.evaluate_policy import evaluate

    rng, batches = np.random.default_rng(0), []

    def explore(observation: "Observation") -> "np.ndarray":
        batches.append(observation)
        actions = np.asarray(policy(observation))
        is_random = rng.random((len(actions), 1)) < RANDOM_FRACTION
        return np.where(is_random, rng.uniform(-1, 1, actions.shape), actions)

    first = 0
    while sum(len(batch["observation"]) for batch in batches) < number:
        evaluate(explore, task, range(first, first + N_EPISODES))
        first += N_EPISODES
    stacked = {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}
    drawn = np.linspace(0, len(stacked["observation"]) - 1, number).astype(int)
    return {name: values[drawn] for name, values in stacked.items()}

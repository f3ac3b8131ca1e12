"""Export the policy of a stored run, or of a pretrained agent, to a file that other programs read."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config.paths import directory_path
from parking_exp.config.schema import ConfigModel, EnvConfig
from parking_exp.config.validate import parse
from parking_exp.errors import ConfigError
from parking_exp.evaluation.agents import ModelName, find_agent
from parking_exp.terminal import say

if TYPE_CHECKING:
    from parking_exp.envs.interface import Observation, Policy

N_OBSERVATIONS = 1000  # on which a file is compared with the model
N_SCENES = 50  # at a time, whole episodes, so that observations are of their ends, too
RANDOM_SHARE = 0.1  # of actions: the policy is also seen where it would not go
NEEDED = {"onnx": ("onnx", "onnxruntime")}
SUFFIXES = {"onnx": ".onnx", "torchscript": ".pt", "safetensors": ".safetensors"}


class ExportRequest(ConfigModel):
    """The config of scripts/export.py."""

    run: Annotated[str, Field(min_length=1)]
    output_dir: str
    model: ModelName
    format: Literal["onnx", "torchscript", "safetensors"]
    path: Annotated[str, Field(min_length=1)] | None
    trust: bool


def validate_request(config: DictConfig) -> ExportRequest:
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with a sentence for each thing that is wrong, or for what is not installed.
    """
    request = parse(ExportRequest, config)
    for name in NEEDED.get(request.format, ()):
        if find_spec(name) is None:
            raise ConfigError(f"format={request.format}: {name} is not installed; pip install 'parking-exp[export]'")
    if request.path is not None:
        path = directory_path(request.path)
        if path.is_dir():
            raise ConfigError(f"path={request.path} is a directory; name a file in it")
        if path.suffix != (suffix := SUFFIXES[request.format]):
            raise ConfigError(f"path={request.path}: the name of a file of format={request.format} ends in {suffix}")
    return request


def export_run(config: DictConfig) -> Path:
    """Write the policy, check the file, and print what came of it; return its path.

    Raises:
        ConfigError: the config is not valid, or the run's algorithm can't be restored exactly.
        ModelError: the model is damaged, can't be exported, or the file's actions are not the model's.
        RunNotFoundError: no run answers to `run`, or it has no such model yet.
        UntrustedError: the stored config would execute what runs are not made of, and `trust` is false.
    """
    request = validate_request(config)
    agent = find_agent(request.run, directory_path(request.output_dir), request.model, trust=request.trust)
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
    observations = observations_of(greedy_policy(model), agent.config.env, N_OBSERVATIONS)
    difference = export_policy(model, request.format, path, observations)
    say(f"exported       {agent.name} as {request.format}, {path.stat().st_size / 1000:.1f} kB")
    say(
        f"checked        on {N_OBSERVATIONS:,} observations: largest difference from torch {difference:.1e} "
        f"({TOLERANCE:g} is allowed)"
    )
    say(f"file           {path}")
    return path


def observations_of(policy: "Policy", env: EnvConfig, number: int) -> "Observation":
    """Return observations of whole episodes that a policy drives, with some random actions; always the same.

    Args:
        policy: what drives.
        env: the `env` group.
        number: of observations, evenly drawn from the episodes' first steps to their last.
    """
    import numpy as np

    from parking_exp.envs.scene_batches import start_scenes

    rng, seen, count, first = np.random.default_rng(0), [], 0, 0
    while count < number:
        batch = start_scenes(env, range(first, first + N_SCENES))
        observation = batch.observe()
        while len(batch):
            seen.append(observation)
            count += len(batch)
            actions = np.asarray(policy(observation))
            at_random = rng.random((len(batch), 1)) < RANDOM_SHARE
            step = batch.step(np.where(at_random, rng.uniform(-1, 1, actions.shape), actions))
            going_on = ~(step.terminated | step.truncated)
            batch.keep(going_on)
            observation = {name: value[going_on] for name, value in step.observation.items()}
        first += N_SCENES
    drawn = np.linspace(0, count - 1, number).astype(int)
    return {name: np.concatenate([one[name] for one in seen])[drawn] for name in seen[0]}

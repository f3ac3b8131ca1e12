"""Export the policy of a stored run or of a pretrained agent to a file."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from omegaconf import DictConfig

from parking_exp.config.paths import absolute_path, resolved
from parking_exp.config.schema import LocalPath
from parking_exp.config.validate import parse_config
from parking_exp.errors import ConfigError, OutputDirectoryError
from parking_exp.evaluation.agents import Agent, AgentRequest, find_agent
from parking_exp.runs.atomic_files import replacing
from parking_exp.terminal import say


class ExportRequest(AgentRequest):
    """The config of scripts/export.py."""

    format: Literal["onnx", "safetensors"]
    path: LocalPath | None


def validate_export(config: DictConfig) -> ExportRequest:
    """Return the checked request of `scripts/export.py`.

    Raises:
        ConfigError: a key is wrong, or a package is missing.
    """
    request = parse_config(ExportRequest, config)
    if request.format == "onnx":
        for name in ("onnx", "onnxruntime"):
            if find_spec(name) is None:
                raise ConfigError(
                    f"format=onnx: {name} is not installed; pip install 'parking-exp[export]'"
                )
    if request.path is not None and not request.path.endswith(f".{request.format}"):
        raise ConfigError(
            f"path={request.path}: a file of format={request.format} ends in .{request.format}"
        )
    return request


@dataclass(frozen=True)
class Export:
    """A request, the agent that it names, and the file to write."""

    request: ExportRequest
    agent: Agent
    path: Path


def export_runs(configs: Sequence[DictConfig]) -> None:
    """Write the policies of the agents that each config names.

    Raises:
        ConfigError: a config is wrong, or two policies would be written to one file; nothing is
            written.
        ModelError: the model can't be exported; also what `agents.load_model` raises.
    """
    requests = [validate_export(config) for config in configs]
    exports = [_find_export(request) for request in requests]
    files = {resolved(export.path) for export in exports}
    if len(files) < len(exports):
        raise ConfigError(
            "two of these policies would be written to one file; export them one by one, each with "
            "a path of its own"
        )
    for export in exports:
        _write(export)


def _find_export(request: ExportRequest) -> Export:
    agent = find_agent(request.run, request.output_path, request.model, trust=request.trust)
    config = agent.config.model_copy(update={"device": "cpu"})  # files are for any machine
    path = agent.folder / "exports" / f"policy.{request.format}"
    if request.path is not None:
        path = absolute_path(request.path)
    return Export(request, replace(agent, config=config), path)


def _write(export: Export) -> None:
    """Write a policy, and say where."""
    agent = export.agent
    path = export.path
    if agent.directory is not None:
        say(f"run directory  {agent.directory.path}")

    content = _content(agent, export.request.format)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_bytes(content)
    except FileNotFoundError as error:  # there are no files, as in /proc
        raise OutputDirectoryError(f"path: {path} cannot be written: {error.strerror}") from error
    size_kb = path.stat().st_size / 1000
    say(
        f"exported       {agent.name} as {export.request.format}, {size_kb:.1f} kB",
        f"file           {path}",
    )


def _content(agent: Agent, file_format: str) -> bytes:
    """Return the file of a policy."""
    from parking_exp.algorithms.onnx_export import export_onnx
    from parking_exp.algorithms.policy_files import export_safetensors
    from parking_exp.tasks.registry import make_task

    with closing(make_task(agent.config.env)) as task:
        model = agent.load(task)
    if file_format == "onnx":
        return export_onnx(model)
    if agent.directory is None:  # its critics are not trained if its own file has none
        return agent.weights.read_bytes()
    return export_safetensors(model)

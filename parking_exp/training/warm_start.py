"""Start a run from the weights, and the replay buffer, of another (`init`, `init_buffer`).

The networks and a tuned entropy coefficient are taken over. Optimizers, schedules, counters and the
average of the policy begin anew. So do the generators: runs of several seeds differ.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from parking_exp.algorithms.build_model import build_model
from parking_exp.algorithms.model_files import load_networks
from parking_exp.algorithms.policy_files import load_policy
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, ModelError
from parking_exp.evaluation.agents import Agent
from parking_exp.evaluation.initial_agents import find_source
from parking_exp.runs.atomic_files import sha256
from parking_exp.runs.checkpoint_files import BUFFER, find_checkpoints
from parking_exp.runs.directory import RunDirectory
from parking_exp.tasks.registry import make_task
from parking_exp.training import checkpoints


def check_sources(configs: Iterable[RunConfig]) -> None:
    """Check the runs that others start from, where these have not begun; one model a cell is made.

    Raises:
        ConfigError: the networks or the replay buffer do not fit.
        RunNotFoundError: there is no such run, or it has no final model yet.
    """
    checked = set()
    for config in configs:
        has_begun = find_checkpoints(RunDirectory(config.run_dir).checkpoints)
        if config.init is None or has_begun:
            continue
        agent = find_source(config)
        if config.init_buffer:
            _find_buffer(config, agent)
        if config.cell_key not in checked:
            checked.add(config.cell_key)
            _check_networks(config, agent)


def _check_networks(config: RunConfig, agent: Agent) -> None:
    """Refuse networks of another kind, or with other layers."""
    expected = _kind_of_networks(config)
    for key, value in _kind_of_networks(agent.config).items():
        if value != expected[key]:
            raise ConfigError(
                f"init={config.init}: its algorithm.{key} is {value}, and this run's is "
                f"{expected[key]}; its networks do not fit"
            )
    task = make_task(config.env)
    try:
        model = build_model(config, task, task.prediction_env(), seed=0, for_training=False)
        _load_networks(config, agent, model)
    finally:
        task.close()


def _kind_of_networks(config: RunConfig) -> dict[str, Any]:
    """Return what networks of the same layers may differ in."""
    algorithm = config.algorithm
    return {
        "_target_": algorithm.class_name,
        "features": algorithm.features,
        "normalize": algorithm.normalize,
        "net_arch": algorithm.net_arch,
        "policy_kwargs": algorithm.arguments.get("policy_kwargs") or {},
    }


def start(config: RunConfig, model: OffPolicyAlgorithm) -> str:
    """Give a fresh model the networks, and the replay buffer, of the run that it starts from.

    Returns:
        The SHA-256 of the file of the weights.

    Raises:
        ConfigError: the networks or the replay buffer do not fit.
        RunNotFoundError: there is no such run, or it has no final model yet.
    """
    agent = find_source(config)
    _load_networks(config, agent, model)
    if config.init_buffer:
        file = _find_buffer(config, agent)
        try:
            checkpoints.load_transitions(file, model.replay_buffer)
        except (LookupError, ValueError) as error:
            raise ConfigError(
                f"init_buffer=true: the replay buffer of init={config.init} does not fit: {error}"
            ) from error
    return sha256(agent.weights)


def _load_networks(config: RunConfig, agent: Agent, model: OffPolicyAlgorithm) -> None:
    try:
        if agent.directory is not None:
            load_networks(agent.weights, model)
            return
        load_policy(agent.weights, model)
    except ModelError as error:
        raise ConfigError(f"init={config.init}: {error}") from error
    # A pretrained agent is an actor alone.
    actor: Any = model.policy.get_submodule("actor")
    target = getattr(model.policy, "actor_target", None)
    if target is not None:
        target.load_state_dict(actor.state_dict())


def _find_buffer(config: RunConfig, agent: Agent) -> Path:
    """Return the file of an agent's last replay buffer.

    Raises:
        ConfigError: it has none, or one of another size.
    """
    for key, value, own in (
        ("n_envs", agent.config.n_envs, config.n_envs),
        ("buffer.buffer_size", agent.config.buffer.buffer_size, config.buffer.buffer_size),
        ("buffer._target_", agent.config.buffer.class_name, config.buffer.class_name),
    ):
        if value != own:
            raise ConfigError(
                f"init_buffer=true: {key} of init={config.init} is {value}, and this run's is "
                f"{own}; its replay buffer does not fit"
            )
    folder = None
    if agent.directory is not None:
        folder = checkpoints.latest(agent.directory.checkpoints)
    if folder is None:
        raise ConfigError(
            f"init_buffer=true: init={config.init} has no checkpoint with a replay buffer; leave "
            "init_buffer out"
        )
    return folder / BUFFER

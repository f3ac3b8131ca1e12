"""Start a run from another run's networks and replay buffer (`init`, `init_buffer`).

Optimizers, schedules, counters, random generators and the EMA of the actor start anew.
"""

from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from parking_exp.algorithms.build_model import build_model
from parking_exp.config.schema import RunConfig
from parking_exp.config.settings import (
    differing_keys,
    display_setting,
    flatten_config,
    with_defaults,
)
from parking_exp.errors import ConfigError, ModelError
from parking_exp.evaluation.agents import Agent
from parking_exp.evaluation.init_sources import find_source
from parking_exp.runs.checkpoint_files import BUFFER, find_checkpoints
from parking_exp.runs.directory import RunDirectory
from parking_exp.tasks.registry import make_task
from parking_exp.training import checkpoints

# Networks that differ in these may have layers of the same shapes.
OF_NETWORKS = ("_target_", "features", "normalize", "net_arch", "policy_kwargs")
NETWORK_KEYS = tuple(f"algorithm.{name}" for name in OF_NETWORKS)
# A stored transition keeps the reward that its run gave it. Keys that begin with one of these
# count, too: `env.reward_weights`, for example.
BUFFER_KEYS = (
    "n_envs",
    "buffer._target_",
    "buffer.buffer_size",
    "env.reward",
    "env.collision_reward",
    "env.standing_reward",
)


def check_sources(configs: Iterable[RunConfig]) -> None:
    """Check the sources of runs that have not begun; one model is built for each cell.

    Raises:
        ConfigError: the networks or the replay buffer are of another kind or size.
        ModelError: the networks have other layers.
        RunNotFoundError: there is no such run, or it has no final model yet.
    """
    checked = set()
    for config in configs:
        has_begun = find_checkpoints(RunDirectory(config.run_dir).checkpoints)
        if config.init is None or has_begun:
            continue
        agent = find_source(config)
        _refuse_differences(config, agent, NETWORK_KEYS)
        if config.init_buffer:
            _find_buffer(config, agent)
        if config.cell_key not in checked:
            checked.add(config.cell_key)
            _check_layers(config, agent)


def _check_layers(config: RunConfig, agent: Agent) -> None:
    """Load networks into a model of a run; raises ModelError if they have other layers."""
    with closing(make_task(config.env)) as task:
        env = task.prediction_env()
        model = build_model(config, task, env, seed=0, for_training=False)
    try:
        agent.load_into(model, networks_only=True)
    except ModelError as error:
        raise ModelError(f"init={config.init}: {error}") from error


def load_source(config: RunConfig, model: OffPolicyAlgorithm) -> Agent:
    """Load what `init` and `init_buffer` name into a fresh model; return the agent.

    It raises what `check_sources` does, and ModelError if the replay buffer does not fit.
    """
    agent = find_source(config)
    agent.load_into(model, networks_only=True)
    if config.init_buffer:
        file = _find_buffer(config, agent)
        checkpoints.load_transitions(file, model.replay_buffer)
    return agent


def _find_buffer(config: RunConfig, agent: Agent) -> Path:
    """Return the file of an agent's last replay buffer; raises ConfigError if none fits."""
    checkpoint = None
    if agent.directory is not None:
        checkpoint = checkpoints.latest(agent.directory.checkpoints)
    if checkpoint is None:
        raise ConfigError(
            f"init_buffer=true: init={config.init} has no checkpoint, and so no replay buffer"
        )
    _refuse_differences(config, agent, BUFFER_KEYS)
    return checkpoint / BUFFER


def _refuse_differences(config: RunConfig, agent: Agent, keys: tuple[str, ...]) -> None:
    target = with_defaults(flatten_config(config.plain()))
    source = with_defaults(flatten_config(agent.config.plain()))
    for key in differing_keys([target, source]):
        is_of_optimizer = key.startswith("algorithm.policy_kwargs.optimizer")
        # Where one config has no arguments of the policy.
        is_empty = key == "algorithm.policy_kwargs"
        if key.startswith(keys) and not (is_of_optimizer or is_empty):
            raise ConfigError(
                f"init={config.init} does not fit: its {key} is "
                f"{display_setting(source.get(key))}, and this run's is "
                f"{display_setting(target.get(key))}"
            )

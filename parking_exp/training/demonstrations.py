"""Demonstrations: episodes of a scripted policy from which a run learns beside its own.

They are made once for the env of a config, and kept in `output_dir/demonstrations`.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any
from zipfile import BadZipFile

import numpy as np
from filelock import FileLock
from hydra.utils import get_class
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from parking_exp.buffers import HerBuffer
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ModelError
from parking_exp.runs.atomic_files import replacing
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.scripted_policy import ScriptedPolicy

DEMONSTRATOR_SEED = 0  # of the policy: the seeds of a cell share their demonstrations
BATCH = 100  # episodes that are driven together: a step of each is kept until the last one ends

Step = tuple[Any, ...]
"""The arguments of `HerBuffer.add`."""


def make_room(config: RunConfig, model: OffPolicyAlgorithm) -> None:
    """Give the replay buffer of a model an empty one for the demonstrations of its run, if any."""
    buffer = model.replay_buffer
    n_episodes = config.buffer.demonstrations
    if not n_episodes:
        return
    assert isinstance(buffer, HerBuffer)
    longest = make_task(config.env).episode_steps
    buffer.demonstrations = type(buffer)(
        n_episodes * longest,
        model.observation_space,
        model.action_space,
        model.device,
        **model.replay_buffer_kwargs,
    )
    buffer.demonstrations.rng = buffer.rng
    buffer.demonstration_share = config.buffer.demonstration_share


def add_demonstrations(
    config: RunConfig, buffer: HerBuffer, on_progress: Callable[[], None]
) -> float:
    """Fill an empty buffer with the demonstrations of a run.

    Args:
        config: of the run.
        buffer: with one env.
        on_progress: called now and then; it may raise to stop.

    Returns:
        The CPU time that it took to make them, in an earlier run maybe [s].

    Raises:
        ModelError: their file is damaged.
    """
    settings = config.buffer
    env = config.env.for_demonstrations()
    key = short_hash([settings.demonstrator, settings.demonstrations, env.model_dump()])
    folder = config.output_path / "demonstrations"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{env.name}-{key}.npz"

    with FileLock(path.with_suffix(".lock")):
        if not path.exists():
            began = time.process_time()
            _record(config, buffer, on_progress)
            cpu_s = time.process_time() - began
            with replacing(path) as temporary, temporary.open("wb") as file:
                np.savez(file, allow_pickle=False, cpu_s=cpu_s, **buffer.storage.get_state())
            return cpu_s

    try:
        with np.load(path, allow_pickle=False) as stored:
            buffer.set_transitions(stored)
            return float(stored["cpu_s"])
    except (ValueError, KeyError, EOFError, BadZipFile) as error:
        raise ModelError(f"{path} is damaged; delete it, and it is made anew") from error


def _record(config: RunConfig, buffer: HerBuffer, on_progress: Callable[[], None]) -> None:
    """Add an episode of the demonstrator for each of the last training seeds."""
    task = make_task(config.env.for_demonstrations())
    demonstrator = get_class(config.buffer.demonstrator)
    policy: ScriptedPolicy = demonstrator(task, DEMONSTRATOR_SEED)
    all_seeds = config.env.training_seeds[-config.buffer.demonstrations :]
    for first in range(0, len(all_seeds), BATCH):
        seeds = all_seeds[first : first + BATCH]
        policy.start(seeds, on_progress)
        envs = task.training_envs(len(seeds))
        envs.seed(seeds.start)
        steps, lengths = _first_episodes(policy, envs, on_progress)
        envs.close()
        for env, length in enumerate(lengths):
            for step in steps[:length]:
                buffer.add(*_of_env(env, step))
    task.close()


def _first_episodes(
    policy: ScriptedPolicy, envs: VecEnv, on_progress: Callable[[], None]
) -> tuple[list[Step], list[int]]:
    """Return steps of all envs until the first episode of each is over, and how long those are."""
    observation: Any = envs.reset()
    under_way = np.ones(envs.num_envs, bool)
    lengths = np.zeros(envs.num_envs, np.int64)
    steps = []
    while under_way.any():
        actions = policy(observation)
        first_of_next: Any
        first_of_next, rewards, dones, infos = envs.step(actions)
        following = {key: values.copy() for key, values in first_of_next.items()}
        for env in np.flatnonzero(dones):
            for key, value in infos[env]["terminal_observation"].items():
                following[key][env] = value
        steps.append((observation, following, actions, rewards, dones, infos))
        lengths[under_way] += 1
        under_way &= ~dones
        observation = first_of_next
        on_progress()
    return steps, lengths.tolist()


def _of_env(env: int, step: Step) -> Iterator[Any]:
    """Yield the parts of a step of many envs, each cut down to one env."""
    only = slice(env, env + 1)
    for part in step:
        if isinstance(part, dict):
            yield {key: values[only] for key, values in part.items()}
        else:
            yield part[only]

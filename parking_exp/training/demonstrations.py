"""Demonstrations: episodes of a scripted policy, which a run learns from beside its own episodes.

They are recorded once for each env, demonstrator and number of episodes, and kept in
`output_dir/demonstrations`.
"""

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from filelock import FileLock, Timeout
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from parking_exp.buffers import HerBuffer
from parking_exp.config.paths import refuse_links
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ModelError
from parking_exp.runs.atomic_files import replacing
from parking_exp.tasks.rollout import seed_batches
from parking_exp.tasks.scripted_policy import ScriptedPolicy, build_scripted_policy
from parking_exp.tasks.task import Task

DEMONSTRATOR_SEED = 0  # all seeds of a cell share their demonstrations
POLL_S = 1.0  # between two looks at whether another run is done with the file

Transition = tuple[Any, ...]
"""The arguments of `HerBuffer.add`, of one env."""


@dataclass(frozen=True)
class DemonstrationStats:
    """The cost and the success of demonstrations."""

    cpu_s: float  # CPU time of recording them
    n_successes: int  # episodes that reached the goal


def attach_demonstration_buffer(config: RunConfig, task: Task, model: OffPolicyAlgorithm) -> None:
    """Attach an empty buffer for demonstrations to the replay buffer of a model."""
    buffer = model.replay_buffer
    assert isinstance(buffer, HerBuffer)
    buffer.demonstrations = type(buffer)(
        config.buffer.demonstrations * task.episode_steps,
        model.observation_space,
        model.action_space,
        model.device,
        **model.replay_buffer_kwargs,
    )
    buffer.demonstrations.rng = buffer.rng
    buffer.demonstration_share = config.buffer.demonstration_share


def add_demonstrations(
    config: RunConfig, task: Task, model: OffPolicyAlgorithm, on_progress: Callable[[int], None]
) -> DemonstrationStats:
    """Fill the demonstration buffer from its file; record the episodes if there is no file.

    Args:
        config: the run's config.
        task: the run's task.
        model: the run's model, after `attach_demonstration_buffer`.
        on_progress: called now and then with the number of recorded episodes; it may raise to
            stop.

    Raises:
        ModelError: the file is damaged.
        UntrustedError: the file is a link that leads out of the output directory.
    """
    buffer: Any = model.replay_buffer
    demonstrations: HerBuffer = buffer.demonstrations
    path = _prepare_file(config, demonstrations)
    lock = FileLock(path.with_suffix(".lock"))
    _wait_for(lock, partial(on_progress, 0))
    try:
        if not path.exists():
            began_s = time.process_time()
            n_successes = _record_episodes(config, task, model, demonstrations, on_progress)
            stats = DemonstrationStats(time.process_time() - began_s, n_successes)
            with replacing(path) as temporary, temporary.open("wb") as file:
                state = demonstrations.storage.get_state()
                np.savez(file, allow_pickle=False, **asdict(stats), **state)
            return stats
    finally:
        lock.release()
    try:
        with np.load(path, allow_pickle=False) as stored:
            demonstrations.set_transitions(stored)
            return DemonstrationStats(float(stored["cpu_s"]), int(stored["n_successes"]))
    except (ValueError, KeyError, EOFError, BadZipFile, ModelError) as error:
        raise ModelError(f"{path} is damaged; delete it, and it is made anew") from error


def _prepare_file(config: RunConfig, buffer: HerBuffer) -> Path:
    """Make the folder of a run's demonstrations and return their file; links are refused."""
    settings = config.buffer
    env = config.env
    content = {
        "demonstrator": settings.demonstrator,
        "demonstrations": settings.demonstrations,
        "env": env.model_dump(),
        "handle_timeout_termination": buffer.handle_timeout_termination,
    }
    folder = config.output_path / "demonstrations"
    path = folder / f"{env.name}-{short_hash(content)}.npz"
    refuse_links([folder, path], config.output_path)
    folder.mkdir(parents=True, exist_ok=True)
    return path


def _wait_for(lock: FileLock, on_progress: Callable[[], None]) -> None:
    """Acquire a lock that another run may hold for minutes."""
    while not lock.is_locked:
        try:
            lock.acquire(timeout=POLL_S)
        except Timeout:
            on_progress()


def _record_episodes(
    config: RunConfig,
    task: Task,
    model: OffPolicyAlgorithm,
    buffer: HerBuffer,
    on_progress: Callable[[int], None],
) -> int:
    """Add an episode for each of the last training seeds, and return how many are successful."""
    n_recorded = 0
    n_successes = 0
    all_seeds = config.env.training_seeds[-config.buffer.demonstrations :]
    arguments = dict(config.buffer.demonstrator)
    target = arguments.pop("_target_")
    policy = build_scripted_policy(target, arguments, task, DEMONSTRATOR_SEED)
    for seeds in seed_batches(all_seeds, task, policy):
        on_batch_progress = partial(on_progress, n_recorded)
        policy.start(seeds, on_batch_progress)
        with closing(task.training_envs(len(seeds))) as envs:
            envs.seed(seeds[0])  # the seeds are consecutive
            episodes = _drive(policy, envs, on_batch_progress)
        n_recorded += len(seeds)
        for episode in episodes:
            for obs, next_obs, action, reward, done, infos in episode:
                scaled = model.policy.scale_action(action)
                buffer.add(obs, next_obs, scaled, reward, done, infos)
            last_infos = episode[-1][-1]
            n_successes += bool(last_infos[0]["is_success"])
    return n_successes


def _drive(
    policy: ScriptedPolicy, envs: VecEnv, on_progress: Callable[[], None]
) -> list[list[Transition]]:
    """Return the first episode of each env."""
    episodes: list[list[Transition]] = [[] for _ in range(envs.num_envs)]
    under_way = np.arange(envs.num_envs)
    observation: Any = envs.reset()
    actions = np.zeros((envs.num_envs, *envs.action_space.shape), envs.action_space.dtype)
    while len(under_way):
        actions[under_way] = policy(_rows(observation, under_way))
        following: Any
        following, rewards, dones, infos = envs.step(actions)
        for env in under_way.tolist():
            only = [env]
            last = _rows(following, only)
            if dones[env]:
                end = infos[env]["terminal_observation"]
                last = {key: np.array(value)[None] for key, value in end.items()}
            before = _rows(observation, only)
            transition = (before, last, actions[only], rewards[only], dones[only], [infos[env]])
            episodes[env].append(transition)
        policy.keep(~dones[under_way])
        under_way = under_way[~dones[under_way]]
        observation = following
        on_progress()
    return episodes


def _rows(observation: dict[str, np.ndarray], rows: Any) -> dict[str, np.ndarray]:
    """Return a copy of some rows of the observations of many envs."""
    return {key: values[rows] for key, values in observation.items()}

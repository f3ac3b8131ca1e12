"""Training envs as a monitored Stable-Baselines3 VecEnv; their state, for exact resume."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.monitor import ResultsWriter
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

from parking_exp.tasks.reset_rng import reset_rng
from parking_exp.tasks.task import Task

MONITOR_STATE = ("episode_returns", "episode_lengths", "episode_count")


class ReplayActions(gym.Wrapper):
    """Restore an env whose state can't be saved, by replaying the actions of its episode.

    The wrapper records the random generator's state before `reset`, and the actions since.
    """

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self._start: Mapping[str, Any] | None = None
        self._actions: list[np.ndarray] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        self._start = reset_rng(self, seed).bit_generator.state
        self._actions = []
        return self.env.reset(seed=seed, options=options)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the env."""
        self._actions.append(np.array(action))
        return self.env.step(action)

    def get_state(self) -> dict[str, Any]:
        """Return what started the episode, and the actions since, shape (steps, actions).

        `start` is None before the first reset.
        """
        actions = np.array(self._actions, self.action_space.dtype)
        shape = (-1, *self.action_space.shape)
        return {"start": self._start, "actions": actions.reshape(shape)}

    def set_state(self, state: dict[str, Any]) -> None:
        """Replay a saved episode up to its last step; what follows is identical."""
        if state["start"] is None:
            return
        self.unwrapped.np_random.bit_generator.state = state["start"]
        self.reset()
        for action in state["actions"]:
            self.step(action)


def make_training_envs(
    task: Task, n_envs: int, monitor: Path | None = None, elapsed_s: float = 0.0
) -> VecMonitor:
    """Make the monitored training envs of a task.

    Args:
        task: the run's task.
        n_envs: number of envs.
        monitor: file of finished training episodes (Stable-Baselines3's Monitor CSV). Rows are
            appended.
        elapsed_s: time that a resumed run has taken before, so that the file's clock continues.
    """
    envs = VecMonitor(task.training_envs(n_envs), info_keywords=task.monitored)
    envs.t_start = time.time() - elapsed_s
    if monitor is not None:
        header: dict[str, float | str] = {"t_start": envs.t_start, "env_id": task.env_id}
        is_new = not monitor.exists()
        envs.results_writer = ResultsWriter(
            str(monitor), header, task.monitored, override_existing=is_new
        )
    return envs


def get_state(envs: VecEnv) -> dict[str, Any]:
    """Return the state of training envs as nested dicts and lists of arrays and numbers."""
    assert isinstance(envs, VecMonitor)
    inner: Any = envs.venv
    has_state = hasattr(inner, "get_state")  # one for all envs, as in the simulator of parking
    return {
        "monitor": {name: getattr(envs, name) for name in MONITOR_STATE},
        "envs": inner.get_state() if has_state else inner.env_method("get_state"),
    }


def set_state(envs: VecEnv, state: dict[str, Any]) -> None:
    """Bring training envs of the same config to a saved state; what follows is identical."""
    assert isinstance(envs, VecMonitor)
    inner: Any = envs.venv
    for name in MONITOR_STATE:
        setattr(envs, name, state["monitor"][name])
    if hasattr(inner, "get_state"):
        inner.set_state(state["envs"])
        return
    inner._reset_seeds()  # the seeds of a first reset, which was before the state was saved
    for index, env_state in enumerate(state["envs"]):
        inner.env_method("set_state", env_state, indices=[index])

"""Evaluation episodes of Gymnasium envs, one env for each episode."""

from collections.abc import Sequence
from itertools import compress
from typing import Any

import gymnasium as gym
import numpy as np

from parking_exp.tasks.task import EvaluationBatch, Observation, Step


class EnvBatch(EvaluationBatch):
    """Episodes of Gymnasium envs that are stepped together, without autoreset.

    Args:
        envs: an env for each episode; `info` of their steps has `is_success` and `failure_key`.
        seeds: the seeds of the episodes, shape (n,).
        failure_key: entry of `info` that is true where an episode ends badly.
    """

    def __init__(self, envs: Sequence[gym.Env], seeds: Sequence[int], failure_key: str) -> None:
        self.envs = list(envs)
        self.failure_key = failure_key
        self._observations = [
            env.reset(seed=int(seed))[0] for env, seed in zip(envs, seeds, strict=True)
        ]

    def __len__(self) -> int:
        return len(self.envs)

    def observe(self) -> Observation:
        """Return the observations of all episodes."""
        return {
            key: np.stack([observation[key] for observation in self._observations])
            for key in self._observations[0]
        }

    def step(self, actions: np.ndarray) -> Step:
        """Step all episodes; actions have the shape (n, actions)."""
        results = [env.step(action) for env, action in zip(self.envs, actions, strict=True)]
        observations, rewards, terminated, truncated, self._infos = zip(*results, strict=True)
        self._observations = list(observations)
        failed = [info[self.failure_key] for info in self._infos]
        is_success = [info["is_success"] for info in self._infos]
        columns = (rewards, terminated, truncated, failed, is_success)
        return Step(self.observe(), *map(np.array, columns))

    def keep(self, rows: np.ndarray) -> None:
        """Keep only some of the episodes, by mask."""
        self.envs = list(compress(self.envs, rows))
        self._observations = list(compress(self._observations, rows))

    def info(self, row: int) -> dict[str, Any]:
        """Return the last `info` of an episode that has just ended."""
        return self._infos[row]

"""Stable-Baselines3's VecEnv of episodes that are simulated together."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from parking_exp.tasks.task import GoalReward, TrainingBatch
from parking_exp.tasks.task_config import TaskConfig


class BatchVecEnv(VecEnv):
    """VecEnv of a batch of episodes; an env starts a new episode when its own ends.

    After `seed(s)`, `reset()` starts the episodes of the seeds s, s + 1 and so on. Later ones are
    sampled by a generator seeded with s.
    """

    render_mode = None  # videos are made by the task

    def __init__(
        self,
        batch: TrainingBatch,
        goal_reward: GoalReward,
        n_envs: int,
        observation_space: spaces.Dict,
        action_space: spaces.Box,
    ) -> None:
        self.batch = batch
        self.goal_reward = goal_reward
        super().__init__(n_envs, observation_space, action_space)
        self._rng = np.random.default_rng()
        self._actions = np.zeros((n_envs, *action_space.shape))

    def from_seeds(self, seeds: list[int]) -> Any:
        """Return what `TrainingBatch.start` takes for the episodes of some seeds."""
        return seeds

    def sample(self, rng: np.random.Generator, number: int) -> Any:
        """Return random episodes; their seeds are above those of all evaluations."""
        # Of all tasks: a task's own range is for the first episodes.
        seeds = TaskConfig.training_seeds
        return rng.integers(seeds.start, seeds.stop, number).tolist()

    def reset(self) -> VecEnvObs:
        """Start an episode in every env and return the first observations."""
        if self._seeds[0] is not None:
            # Not the stream that the episode of seed s itself is sampled from.
            self._rng = np.random.default_rng((self._seeds[0], 1))
            episodes = self.from_seeds([seed or 0 for seed in self._seeds])
        else:
            episodes = self.sample(self._rng, self.num_envs)
        self.batch.start(episodes)
        self._reset_seeds()
        return self.batch.observe()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next step, shape (n_envs, actions)."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step all envs. Where an episode ended, the observation is the next one's first."""
        step = self.batch.step(self._actions)
        done = step.terminated | step.truncated
        failure_key = self.goal_reward.failure_key
        infos: list[dict[str, Any]] = []
        for success, failed in zip(step.is_success.tolist(), step.failed.tolist(), strict=True):
            infos.append({"is_success": success, failure_key: failed})

        ended = np.flatnonzero(done)
        if len(ended):
            for row in ended:
                last = {key: value[row].copy() for key, value in step.observation.items()}
                is_time_limit = bool(step.truncated[row] and not step.terminated[row])
                infos[row] |= {"terminal_observation": last, "TimeLimit.truncated": is_time_limit}
            self.batch.start(self.sample(self._rng, len(ended)), ended)
            for key, value in self.batch.observe(ended).items():
                step.observation[key][ended] = value
        return step.observation, step.reward.astype(np.float32), done, infos

    def get_state(self) -> dict[str, Any]:
        """Return the whole state, the generator of episodes included."""
        rng = self._rng.bit_generator.state
        return {"simulator": self.batch.get_state(), "rng": rng, "seeds": list(self._seeds)}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state; what follows is identical."""
        self.batch.set_state(state["simulator"])
        self._rng.bit_generator.state = state["rng"]
        self._seeds = list(state["seeds"])

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute for each of the envs, which share it."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None
    ) -> None:
        """Refuse: the envs share everything."""
        raise NotImplementedError

    def env_method(
        self,
        method_name: str,
        *args: Any,
        indices: int | Iterable[int] | None = None,
        **kwargs: Any,
    ) -> list[Any]:
        """Call a method for each of the envs, such as `compute_reward`, which HER needs."""
        return [getattr(self, method_name)(*args, **kwargs) for _ in self._get_indices(indices)]

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: object = None
    ) -> np.ndarray:
        """Return the reward of goals, without a penalty for failures.

        Its shape is (batch,); goals have the shape (batch, size of a goal).
        """
        return self.goal_reward(achieved_goal, desired_goal)[0]

    def env_is_wrapped(
        self, wrapper_class: type, indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """Return that no env is wrapped."""
        return [False for _ in self._get_indices(indices)]

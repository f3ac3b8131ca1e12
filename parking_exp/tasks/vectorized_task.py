"""The base class of tasks that are written as functions of arrays, with a row for each episode."""

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import spaces

from parking_exp.errors import class_and_message
from parking_exp.tasks.task import (
    GoalReward,
    Observation,
    Step,
    Task,
    TrainingBatch,
)

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

State = dict[str, np.ndarray]
"""The state of n episodes: arrays of shape (n, ...) by name. The batch adds `steps`."""


class VectorizedTask(Task):
    """A task that is made of functions of arrays, in which each row is an episode.

    A subclass defines `start`, `observe`, `step`, `reward` and the attributes below. The rest
    follows: training envs whose state can be saved, HER, and evaluation. In metrics, `episode.end`
    is the state of an episode at its end, without the first axis.

    Attributes:
        observation_space: `observation`, `achieved_goal` and `desired_goal`, each a `Box`.
        action_space: a `Box` of floats with finite bounds.
        episode_steps: steps after which an episode is truncated.
    """

    observation_space: spaces.Dict
    action_space: spaces.Box

    @abstractmethod
    def start(self, seeds: Sequence[int]) -> State:
        """Return the state in which the episodes of some seeds start; a seed has one start."""

    @abstractmethod
    def observe(self, state: State) -> Observation:
        """Return the observations of a state, each entry of shape (n, size)."""

    @abstractmethod
    def step(self, state: State, actions: np.ndarray) -> State:
        """Return the next state; actions have the shape (n, actions)."""

    @abstractmethod
    def reward(self, achieved: np.ndarray, desired: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rewards and whether goals are reached, which ends an episode, both of shape (n,).

        Achieved and desired goals have the shape (n, size).
        """

    def failed(self, state: State) -> np.ndarray:
        """Return whether episodes have failed, which ends them, shape (n,)."""
        return np.zeros(len(state["steps"]), bool)

    def training_envs(self, n_envs: int) -> "VecEnv":
        """Make training envs that are stepped together."""
        from parking_exp.tasks.batch_vec_env import BatchVecEnv  # it imports torch

        batch = ArrayBatch(self, range(n_envs))
        reward = TaskReward(self)
        return BatchVecEnv(batch, reward, n_envs, self.observation_space, self.action_space)

    def evaluation_batch(self, seeds: Sequence[int], simulator: str | None) -> "ArrayBatch":
        """Start the episodes of some seeds."""
        return ArrayBatch(self, seeds)

    def problems(self) -> Iterator[str]:
        """Yield what is wrong with the start and the first step of two episodes."""
        try:
            yield from self._first_step_problems()
        except Exception as error:  # whatever the functions of a subclass raise
            yield f"env.task: {self.env_id}: {class_and_message(error)}"

    def _first_step_problems(self) -> Iterator[str]:
        batch = ArrayBatch(self, [0, 1])
        actions = np.zeros((2, *self.action_space.shape), self.action_space.dtype)
        step = batch.step(actions)
        arrays = {"reward": step.reward, "failed": step.failed, "reached": step.is_success}
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(arrays, (2,))
        for key, space in self.observation_space.items():
            arrays[key] = step.observation[key]
            shapes[key] = (2, *(space.shape or ()))
        for name, array in arrays.items():
            if array.shape != shapes[name]:
                yield (
                    f"env.task: {self.env_id}: {name} of two episodes has the shape "
                    f"{array.shape}, not {shapes[name]}"
                )


class TaskReward(GoalReward):
    """The reward of a task, as HER takes it."""

    def __init__(self, task: VectorizedTask) -> None:
        self.task = task

    def __call__(
        self, achieved: np.ndarray, desired: np.ndarray, info: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return reward and whether the goal is reached, both of shape (n,)."""
        return self.task.reward(achieved, desired)


class ArrayBatch(TrainingBatch):
    """Episodes of a task that are stepped together, without autoreset."""

    def __init__(self, task: VectorizedTask, seeds: Sequence[int]) -> None:
        self.task = task
        self.start(seeds)

    def __len__(self) -> int:
        return len(self.state["steps"])

    def start(self, episodes: Sequence[int], rows: np.ndarray | None = None) -> None:
        """Start the episodes of some seeds, in all rows or in some."""
        state = {**self.task.start(episodes), "steps": np.zeros(len(episodes), np.int64)}
        if rows is None:
            self.state = state
            return
        for name, values in state.items():
            changed = self.state[name].copy()  # a task may keep the array that it has returned
            changed[rows] = values
            self.state[name] = changed

    def observe(self, rows: Any = slice(None)) -> Observation:
        """Return the observations of all episodes, or of some."""
        observation = self.task.observe(self._take(rows))
        return {  # copies, since the state may be part of the observation
            key: np.array(observation[key], space.dtype)
            for key, space in self.task.observation_space.items()
        }

    def step(self, actions: np.ndarray) -> Step:
        """Step all episodes; actions have the shape (n, actions)."""
        steps = self.state["steps"] + 1
        self.state = {**self.task.step(self.state, actions), "steps": steps}
        observation = self.observe()
        reward, reached = self.task.reward(
            observation["achieved_goal"], observation["desired_goal"]
        )
        failed = self.task.failed(self.state)
        return Step(
            observation=observation,
            reward=reward,
            terminated=failed | reached,
            truncated=steps >= self.task.episode_steps,
            failed=failed,
            is_success=reached,
        )

    def keep(self, rows: np.ndarray) -> None:
        """Keep only some of the episodes, by mask."""
        self.state = self._take(rows)

    def ending(self, row: int) -> State:
        """Return the state of one episode."""
        return self._take(row)

    def get_state(self) -> State:
        """Return the state, to be saved and given to `set_state`."""
        return self._take(slice(None))

    def set_state(self, state: State) -> None:
        """Restore a state; what follows is identical."""
        self.state = dict(state)

    def _take(self, rows: Any) -> State:
        return {name: values[rows] for name, values in self.state.items()}

"""The task interface: how to train on a goal-conditioned task, evaluate it and judge an episode."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from parking_exp.errors import VideoError
from parking_exp.tasks.metrics import GYMNASIUM_METRICS, Metric

if TYPE_CHECKING:
    import pandas as pd
    from stable_baselines3.common.vec_env import VecEnv

    from parking_exp.report_section import Section

Observation = dict[str, np.ndarray]
"""`observation`, `achieved_goal`, `desired_goal`; each of shape (...) or (batch, ...)."""


class Step(NamedTuple):
    """Result of one step of n episodes; all but the observation have the shape (n,)."""

    observation: Observation
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    failed: np.ndarray
    is_success: np.ndarray


class GoalReward(ABC):
    """The reward of reaching goals, for many of them at once.

    Attributes:
        failure_penalty: the penalty, at most 0, that the reward of a failing step includes.
        failure_key: the entry of `info` that is true at such a step.
        velocity: which entries of a goal are a velocity.
    """

    failure_penalty: float = 0.0
    failure_key: str = "is_failure"
    velocity: tuple[int, ...] = ()

    @property
    def info_keys(self) -> tuple[str, ...]:
        """Entries of `info` that the reward depends on, beside the goals; each is a number."""
        return ()

    @property
    def terminates(self) -> bool:
        """Whether an episode ends where its goal is reached."""
        return True

    @abstractmethod
    def __call__(
        self, achieved: np.ndarray, desired: np.ndarray, info: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return reward and whether the goal is reached, shape (n,); `info` is (n, info_keys)."""


class Policy(ABC):
    """A policy, which chooses the actions of episodes that are stepped together.

    Attributes:
        max_batch_size: the largest number of episodes that it is given at once.
    """

    max_batch_size = sys.maxsize

    def start(  # noqa: B027 most policies need no preparation
        self, seeds: Sequence[int], on_progress: Callable[[], None] | None = None
    ) -> None:
        """Prepare for the episodes of a batch, which start now.

        Call `on_progress` now and then if this takes long; it may raise to stop.
        """

    @abstractmethod
    def __call__(self, observation: Observation) -> np.ndarray:
        """Return the actions of all episodes of the batch, shape (n, actions)."""

    def keep(self, rows: np.ndarray) -> None:  # noqa: B027 most policies have no state
        """Keep the episodes where the mask `rows` is true; the others have ended."""

    def info(self, row: int) -> Mapping[str, Any]:
        """Return entries of `Episode.info` for an episode that has just ended."""
        return {}


class EvaluationBatch(ABC):
    """Episodes that are stepped together, each from its own seed, without autoreset."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of episodes that are under way."""

    @abstractmethod
    def observe(self) -> Observation:
        """Return the observations of all episodes."""

    @abstractmethod
    def step(self, actions: np.ndarray) -> Step:
        """Step all episodes; actions have the shape (n, actions)."""

    @abstractmethod
    def keep(self, rows: np.ndarray) -> None:
        """Keep only some of the episodes, by mask."""

    def ending(self, row: int) -> Any:
        """Return the final state of an episode that has just ended, as `Episode.end`.

        It is None if only the outcome is known.
        """
        return None

    def info(self, row: int) -> Mapping[str, Any]:
        """Return the last `info` of an episode that has just ended, as `Episode.info`."""
        return {}


class TrainingBatch(EvaluationBatch):
    """Episodes that are stepped together, of which each can start anew."""

    @abstractmethod
    def start(self, episodes: Any, rows: np.ndarray | None = None) -> None:
        """Start other episodes, in all rows or in some."""

    @abstractmethod
    def observe(self, rows: Any = slice(None)) -> Observation:
        """Return the observations of all episodes, or of some."""

    @abstractmethod
    def get_state(self) -> dict[str, np.ndarray]:
        """Return a copy of the state."""

    @abstractmethod
    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state; what follows is identical."""


class Task(ABC):
    """A goal-conditioned task: how to train on it, evaluate a policy and judge an episode.

    A subclass defines `training_envs`, `evaluation_batch` and `episode_steps`. A task whose
    episodes are rows of arrays is easier to write as a `VectorizedTask`.

    Attributes:
        metrics: the metrics of an evaluation episode; `success` is always there.
        failure: the outcome of an episode that ends badly, by its name in this task.
        monitored: entries of `info` that `monitor.csv` records for each training episode.
        batch_size: evaluation episodes that are stepped together.
    """

    metrics: tuple[Metric, ...] = GYMNASIUM_METRICS
    failure = "failure"
    monitored: tuple[str, ...] = ("is_success",)
    batch_size = 500  # long episodes keep a batch going, so few large ones are faster
    _prediction_env: "VecEnv | None" = None

    @abstractmethod
    def training_envs(self, n_envs: int) -> "VecEnv":
        """Make new training envs, which share nothing with those of earlier calls.

        The VecEnv has an attribute `goal_reward`, a `GoalReward`, with which HER relabels. For
        checkpoints, the VecEnv or each env has `get_state` and `set_state`. A state consists of
        nested dicts and lists of arrays, numbers and text.
        """

    @abstractmethod
    def evaluation_batch(self, seeds: Sequence[int], simulator: str | None) -> EvaluationBatch:
        """Start the episodes of some seeds.

        `simulator` is one of the config's `simulators`, or None for its `simulator`.
        """

    @property
    @abstractmethod
    def episode_steps(self) -> int:
        """The longest training episode, in steps."""

    @property
    def env_id(self) -> str:
        """Name for messages and `monitor.csv`."""
        return type(self).__name__

    @property
    def frame_rate(self) -> int:
        """Frames per second of `frames`."""
        return 30

    def prediction_env(self) -> "VecEnv":
        """Return one env with the task's spaces, for models that only predict.

        The first call makes it, and `close` closes it.
        """
        if self._prediction_env is None:
            self._prediction_env = self._make_prediction_env()
        return self._prediction_env

    def _make_prediction_env(self) -> "VecEnv":
        """Make the env of `prediction_env`; by default, it is a training env."""
        return self.training_envs(1)

    def close(self) -> None:
        """Close the envs of evaluations and predictions."""
        if self._prediction_env is not None:
            self._prediction_env.close()
            self._prediction_env = None

    def problems(self) -> Iterator[str]:
        """Yield what is wrong with the environment itself; this may take seconds."""
        yield from ()

    def notes(self) -> Iterator[str]:
        """Yield what a user should know when a training starts."""
        yield from ()

    def features(self, name: str) -> tuple[type, dict[str, Any]] | None:
        """Return the class of a named features extractor and its arguments; None for `raw`."""
        return None

    def positions(self, observation: Observation) -> dict[str, np.ndarray]:
        """Return where n episodes are, by name, each of shape (n,).

        These are columns of the paths that a run keeps of its final episodes. A task without
        positions has no paths.
        """
        return {}

    def frames(self, policy: Policy, seeds: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield the frames of a video of some episodes, shape (height, width, 3).

        Call `policy.start` before the first action of each episode, or step it by `rollout`.

        Raises:
            VideoError: the task draws no frames.
        """
        raise VideoError(f"no video: {self.env_id} draws no frames")

    def replay_page(self, policy: Policy, seeds: Sequence[int], title: str) -> str:
        """Return a page, one HTML file, that plays some episodes.

        Raises:
            VideoError: the task has no such page.
        """
        raise VideoError(f"no replay: {self.env_id} has no page that plays episodes")


@dataclass(frozen=True)
class TaskReport:
    """The part of a report that is specific to one task.

    Attributes:
        methods: sentences on how results are defined.
        sections: the sections of the report.
        cell_data: returns the data of a cell for the sections. Its arguments are a frame of final
            episodes (EPISODE_SEED, outcome) for each run, and the config by dotted keys.
        figure_data: returns further data of a cell for the figures. Its arguments are a frame of
            the paths of one run (EPISODE_SEED, step, positions, outcome), which may be empty, and
            the config by dotted keys.
    """

    methods: Sequence[str]
    sections: Sequence["Section"]
    cell_data: Callable[["Sequence[pd.DataFrame]", Mapping[str, Any]], dict[str, Any]]
    figure_data: Callable[["pd.DataFrame", Mapping[str, Any]], Any]

"""Types of policies, steps and batches of scenes that highway-env and the simulator share."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from parking_exp.envs.outcomes import Pose

Observation = dict[str, np.ndarray]
"""`observation`, `achieved_goal`, `desired_goal`: of shape (6,), or (batch, 6)."""

Policy = Callable[[Observation], np.ndarray]
"""A batch of observations -> actions of shape (batch, 2): acceleration and steering in [-1, 1]."""


class Step(NamedTuple):
    """Result of one policy step of n scenes.

    Attributes:
        observation: Dict observation; each entry has shape (n, features).
        reward: shape (n,).
        terminated, truncated, crashed, is_success: booleans, shape (n,).
    """

    observation: Observation
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    crashed: np.ndarray
    is_success: np.ndarray


class SceneBatch(Protocol):
    """n scenes that are stepped together, and never reset by themselves."""

    def __len__(self) -> int: ...

    def observe(self) -> Observation:
        """Return the observation of all scenes."""

    def step(self, actions: np.ndarray) -> Step:
        """Step all scenes; actions have the shape (n, actions)."""

    def keep(self, rows: np.ndarray) -> None:
        """Go on with some of the scenes only, by mask."""

    def pose(self, row: int) -> Pose:
        """Return the pose of a car relative to its goal."""

    def cars(self) -> np.ndarray:
        """Return x [m], y [m], heading [rad] and signed speed [m/s] of all cars, shape (n, 4)."""

    def close(self) -> None:
        """Free resources."""

"""Types of policies, observations and steps that highway-env and the simulator share."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Observation = dict[str, np.ndarray]
"""`observation`, `achieved_goal`, `desired_goal`: of shape (6,), or (batch, 6)."""

Policy = Callable[[Observation], np.ndarray]
"""A batch of observations -> actions of shape (batch, 2): acceleration and steering in [-1, 1]."""


class Step(NamedTuple):
    """Result of one policy step of n scenes; all but the observation have the shape (n,)."""

    observation: Observation
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    crashed: np.ndarray
    is_success: np.ndarray

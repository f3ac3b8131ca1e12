"""What a policy is to everything that runs one."""

from collections.abc import Callable

import numpy as np

Observation = dict[str, np.ndarray]
"""`observation`, `achieved_goal`, `desired_goal`: of shape (6,), or (batch, 6)."""

Policy = Callable[[Observation], np.ndarray]
"""A batch of observations -> actions of shape (batch, 2): acceleration and steering in [-1, 1]."""

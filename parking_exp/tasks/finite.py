"""Refuse numbers that are not finite, before a replay buffer or a result has them."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from parking_exp.errors import DivergenceError


def check_finite(values: Mapping[str, Any], where: str) -> None:
    """Check arrays and numbers.

    Args:
        values: arrays and numbers by name, such as the entries of an observation.
        where: where they are from, for the error: `at step 100`.

    Raises:
        DivergenceError: one of them is NaN or infinite.
    """
    for name, array in values.items():
        if not np.isfinite(array).all():
            raise DivergenceError(f"{name} is not finite {where}")

"""Checks of values that all functions share."""

import math
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike


def finite(values: ArrayLike, purpose: str) -> np.ndarray:
    """Return `values` as a float array of shape (n,), n >= 1; raise ValueError for other shapes, NaN and infinity."""
    array = np.asarray(values, dtype=float)
    if array.ndim != 1 or array.size == 0 or not np.isfinite(array).all():
        raise ValueError(f"{purpose} takes a flat array of one or more finite values")
    return array


def finite_or_none(value: object) -> float | None:
    """Return a finite number as a float, None for anything else."""
    return float(value) if isinstance(value, Real) and math.isfinite(value) else None

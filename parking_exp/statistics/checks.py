"""Checks of arguments that all functions share."""

import numpy as np
from numpy.typing import ArrayLike


def finite(values: ArrayLike, what: str) -> np.ndarray:
    """Return `values` as a flat float array, shape (n,) with n >= 1.

    Raises:
        ValueError: it is empty, not one-dimensional, or holds NaN or infinity.
    """
    array = np.asarray(values, dtype=float)
    if array.ndim != 1:
        raise ValueError(f"{what} takes a flat array of values, not one of shape {array.shape}")
    if array.size == 0:
        raise ValueError(f"{what} needs at least one value")
    if not np.isfinite(array).all():
        bad = int(np.count_nonzero(~np.isfinite(array)))
        raise ValueError(f"{what} takes finite values: {bad} of {array.size} are NaN or infinite")
    return array


def confident(confidence: float) -> float:
    """Return `confidence`.

    Raises:
        ValueError: it does not lie strictly between 0 and 1.
    """
    if not 0 < confidence < 1:
        raise ValueError(f"confidence lies between 0 and 1, not at {confidence}")
    return confidence

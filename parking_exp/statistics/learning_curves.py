"""Learning curves: the area under one, and the time to a threshold."""

import numpy as np
from numpy.typing import ArrayLike

THRESHOLD = 0.9  # success
HOLD = 3  # evaluations in a row


def normalised_area(steps: ArrayLike, values: ArrayLike) -> float:
    """Return the area under a learning curve over the range of its steps: 1 means always at 1.

    The area consists of trapezoids between evaluations. It is divided by the range they cover. NaN
    values are dropped. A single evaluation is its own area.
    """
    all_values = np.asarray(values, dtype=float)
    known = ~np.isnan(all_values)
    known_values = all_values[known]
    known_steps = np.asarray(steps)[known]
    if len(known_steps) == 1:
        return float(known_values[0])
    return float(np.trapezoid(known_values, known_steps) / (known_steps[-1] - known_steps[0]))


def steps_to(
    steps: ArrayLike, rates: ArrayLike, threshold: float = THRESHOLD, hold: int = HOLD
) -> float | None:
    """Return the first step from which `hold` evaluations in a row reach a threshold, if any.

    `steps`, shape (evaluations,), rises. NaN rates are below the threshold.
    """
    at = np.asarray(steps)
    if len(at) < hold:
        return None
    reached = np.asarray(rates, dtype=float) >= threshold
    held = np.lib.stride_tricks.sliding_window_view(reached, hold).all(axis=1)
    return float(at[held.argmax()]) if held.any() else None

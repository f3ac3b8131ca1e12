"""Area under a learning curve."""

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.checks import finite


def normalised_area(steps: ArrayLike, values: ArrayLike) -> float:
    """Return the area under a learning curve over the range of its steps: 1 means always at 1.

    The curve starts at its first evaluation (what an untrained policy does is not assumed to be 0), runs in
    trapezoids and is divided by the range that it covers. NaN values are dropped. A single
    evaluation is its own area.

    Raises:
        ValueError: no evaluation is a number, or the shapes differ.
    """
    at, value = finite(steps, "an area under a curve"), np.asarray(values, dtype=float)
    if value.shape != at.shape:
        raise ValueError(f"{len(at)} steps and values of shape {value.shape} do not belong together")
    at, value = at[~np.isnan(value)], value[~np.isnan(value)]
    if not len(at):
        raise ValueError("an area needs at least one evaluation that is a number")
    return float(np.trapezoid(value, at) / (at[-1] - at[0])) if len(at) > 1 else float(value[0])

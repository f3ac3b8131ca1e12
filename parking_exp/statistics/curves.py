"""Area under a learning curve."""

import numpy as np
from numpy.typing import ArrayLike

from parking_exp.statistics.checks import finite


def normalised_area(steps: ArrayLike, values: ArrayLike, horizon: float | None = None) -> float:
    """Return the area under a learning curve over the range of its steps: 1 means always at 1.

    The curve starts at its first evaluation (what an untrained policy does is not assumed to be 0), runs in
    trapezoids and is divided by the range that it covers. NaN values are dropped. With `horizon`, in steps, it ends
    there, interpolated; a curve that ended sooner is not prolonged. A single evaluation is its own area.

    Raises:
        ValueError: nothing is left up to `horizon`, the shapes differ, or steps do not rise.
    """
    at, value = finite(steps, "an area under a curve"), np.asarray(values, dtype=float)
    if value.shape != at.shape:
        raise ValueError(f"{len(at)} steps and values of shape {value.shape} do not belong together")
    if (np.diff(at) <= 0).any():
        raise ValueError("the steps of a curve must rise")
    known = ~np.isnan(value)
    at, value = at[known], value[known]
    if not len(at) or (horizon is not None and at[0] > horizon):
        raise ValueError("an area needs at least one evaluation that is a number, up to the horizon")
    finite(value, "an area under a curve")
    if horizon is not None and at[-1] > horizon:
        end = np.interp(horizon, at, value)
        before = at < horizon
        at, value = np.append(at[before], horizon), np.append(value[before], end)
    if len(at) == 1:
        return float(value[0])
    return float(np.trapezoid(value, at) / (at[-1] - at[0]))

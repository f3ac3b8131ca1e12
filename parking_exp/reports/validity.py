"""Values in a store that are impossible, such as a rate of 7.5: they count as missing, and are said."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from parking_exp.errors import first_few, quoted_label
from parking_exp.results.frames import RATES, Results

Bounds = Mapping[str, tuple[float, float]]

SECONDS, LENGTH = (0.0, 1e12), (0.0, 1e9)
RETURN = (-1e9, 1e9)
RUNS: Bounds = {
    **dict.fromkeys(RATES, (0.0, 1.0)),
    **dict.fromkeys(("episode_steps", "distance_m", "heading_error_rad", "speed_mps"), LENGTH),
    "episode_return": RETURN,
    "n_scenes": (1, 1e9),
    "cpu_s": SECONDS,
    "wall_s": SECONDS,
}
CURVES: Bounds = {
    **dict.fromkeys((*RATES, "real_share"), (0.0, 1.0)),
    "return_mean": RETURN,
    "steps_mean": LENGTH,
    "cpu_s": SECONDS,
}
STEPS = (0, 1e12)


def valid(results: Results) -> tuple[Results, list[str]]:
    """Return results without impossible values, and a sentence for each run that has some."""
    found: dict[str, list[str]] = {}
    known = results.curves["step"].between(*STEPS)
    for run_id, step in results.curves.loc[~known, ["run_id", "step"]].itertuples(index=False):
        found.setdefault(run_id, []).append(f"step={step}")
    runs = _blanked(results.runs, RUNS, found)
    curves = _blanked(results.curves[known].reset_index(drop=True), CURVES, found)
    sentences = [
        f"run {run_id} ({quoted_label(cell)}, seed {seed}): impossible values count as missing: "
        f"{first_few(found[run_id])}."
        for run_id, cell, seed in runs[["run_id", "cell", "seed"]].itertuples(index=False)
        if run_id in found
    ]
    return replace(results, runs=runs, curves=curves), sentences


def _blanked(table: pd.DataFrame, bounds: Bounds, found: dict[str, list[str]]) -> pd.DataFrame:
    """Return a table in which values out of bounds are missing; add them to those found, by run id."""
    columns = {}
    for name, (low, high) in bounds.items():
        values = table[name].to_numpy(dtype="float64", na_value=np.nan)
        bad = (values < low) | (values > high)  # NaN is neither
        if bad.any():
            columns[name] = table[name].mask(bad)
        for run_id, value in zip(table.loc[bad, "run_id"], values[bad], strict=True):
            found.setdefault(run_id, []).append(f"{name}={value:g}")
    return table.assign(**columns)

"""Treat impossible values in a store as missing, and warn about them.

`load` drops values that are not of their column's type: SQLite keeps whatever is written into a column, so that a time
may be a word. Reports drop numbers out of bounds as well, such as a rate of 7.5.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from reprlib import repr as shortened
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from parking_exp.errors import first_few, quoted_label
from parking_exp.evaluation.metrics import METRICS, RUN_METRICS, Bounds
from parking_exp.tracking.reader import Point, StoredRun

if TYPE_CHECKING:
    from parking_exp.results.frames import Results

ENV_STEPS: Bounds = (0, 1e12)
RUN_BOUNDS: dict[str, Bounds] = {
    **{metric.run_column: metric.bounds for metric in METRICS},
    "n_scenes": (1, 1e9),
    **{metric.name: metric.bounds for metric in RUN_METRICS if metric.in_runs},
}
CURVE_BOUNDS: dict[str, Bounds] = {
    **{metric.key: metric.bounds for metric in METRICS if metric.in_curves},
    **{metric.name: metric.bounds for metric in RUN_METRICS if metric.in_curves},
}

Found = dict[str, list[str]]
"""What is impossible, as `name=value`, by run id."""


def sound_runs(runs: Iterable[StoredRun]) -> tuple[list[StoredRun], Found]:
    """Return runs without values of another type, and these."""
    sound: list[StoredRun] = []
    found: Found = {}
    for run in runs:
        bad: list[str] = []
        kept = replace(
            run,
            name=_kept("name", run.name, str, "", bad),
            start_ms=_kept("start_time", run.start_ms, int | None, None, bad),
            end_ms=_kept("end_time", run.end_ms, int | None, None, bad),
            artifact_uri=_kept("artifact_uri", run.artifact_uri, str, "", bad),
            tags=_entries(run.tags, str, bad),
            params=_entries(run.params, str, bad),
            metrics=_entries(run.metrics, float | int, bad),
        )
        sound.append(kept)
        if bad:
            found[run.run_id] = bad
    return sound, found


def sound_points(histories: Mapping[str, Sequence[Point]]) -> tuple[dict[str, list[Point]], Found]:
    """Return histories without points of another type, and these."""
    sound: dict[str, list[Point]] = {}
    found: Found = {}
    for key, points in histories.items():
        sound[key] = [point for point in points if _is_sound(point)]
        bad = [point for point in points if not _is_sound(point)] if len(sound[key]) < len(points) else []
        for run_id, step, time_ms, value in bad:
            where = f"step={shortened(step)}, time={shortened(time_ms)}"
            found.setdefault(run_id, []).append(f"{key}={shortened(value)} ({where})")
    return sound, found


def within_bounds(results: "Results") -> tuple["Results", list[str]]:
    """Return results without numbers out of bounds, and a sentence for each run that has some."""
    found: Found = {}
    known = results.curves["step"].between(*ENV_STEPS)
    for run_id, step in results.curves.loc[~known, ["run_id", "step"]].itertuples(index=False):
        found.setdefault(run_id, []).append(f"step={step}")
    runs = _blanked(results.runs, RUN_BOUNDS, found)
    curves = _blanked(results.curves[known].reset_index(drop=True), CURVE_BOUNDS, found)
    sentences = [
        f"run {run_id} ({quoted_label(cell)}, seed {seed}): impossible values count as missing: "
        f"{first_few(found[run_id])}."
        for run_id, cell, seed in runs[["run_id", "cell", "seed"]].itertuples(index=False)
        if run_id in found
    ]
    return replace(results, runs=runs, curves=curves), sentences


def _is_sound(point: Point) -> bool:
    _, step, time_ms, value = point
    return isinstance(step, int) and isinstance(time_ms, int) and isinstance(value, float | int)


def _entries(values: Mapping[str, Any], kind: Any, bad: list[str]) -> dict[str, Any]:
    bad += [f"{key}={shortened(value)}" for key, value in values.items() if not isinstance(value, kind)]
    return {key: value for key, value in values.items() if isinstance(value, kind)}


def _kept(name: str, value: Any, kind: Any, missing: Any, bad: list[str]) -> Any:
    if isinstance(value, kind):
        return value
    bad.append(f"{name}={shortened(value)}")
    return missing


def _blanked(table: pd.DataFrame, bounds: Mapping[str, Bounds], found: Found) -> pd.DataFrame:
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

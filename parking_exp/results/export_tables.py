"""The CSV files of an export: their columns, and frames to texts."""

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from parking_exp.envs.outcomes import OUTCOMES
from parking_exp.evaluation.metrics import SHARE
from parking_exp.results.invalid_values import CURVE_BOUNDS

if TYPE_CHECKING:
    from parking_exp.results.frames import Results

Columns = dict[str, list[str]]

TABLES = ("runs.csv", "common.csv", "curves.csv", "episodes.csv", "trajectories.csv")
LOCAL_COLUMNS = ("run_dir", "artifact_uri", "config.output_dir", "config.tracking.uri")
"""Columns of runs that name a place; an export has none of them."""
IN_EACH_ROW = ("run_id", "experiment", "cell", "seed", "status")
"""Columns that `runs.csv` has even where they are the same in all runs."""
EPISODE_COLUMNS = ("run", "step", "first_scene", "outcomes", "certified")
TRAJECTORY_COLUMNS = ("run", "scene", "steps", "every", "x_cm", "y_cm", "heading_crad")
UNITS = {"x_cm": "x_m", "y_cm": "y_m", "heading_crad": "heading_rad"}
LETTERS = "".join(outcome[0] for outcome in OUTCOMES)
DIGITS, CURVE_DIGITS = 6, 5
PATH = re.compile(r"(?<![\w.~:/])(?:(?:sqlite|file):/*)?~?/(?:[^\s/'\",:;)\]]+/)*([^\s/'\",:;)\]]+)/?")
TIME = "%Y-%m-%dT%H:%M:%S.%fZ"


def without_paths(words: str) -> str:
    """Return a text in which absolute paths are only their last part."""
    return PATH.sub(r"\1", words)


def table_texts(results: "Results", trajectories: Mapping[str, pd.DataFrame]) -> dict[str, str]:
    """Return the texts of the files.

    Args:
        results: to be exported.
        trajectories: rows of `Results.trajectories` to be kept, by run id; see `export.write_export`.
    """
    runs = results.runs
    number = {run_id: row for row, run_id in enumerate(runs["run_id"])}
    columns = {str(name): _run_texts(str(name), runs[name]) for name in runs if name not in LOCAL_COLUMNS}
    same = [name for name, texts in columns.items() if len(set(texts)) == 1 and name not in IN_EACH_ROW]
    common = {"column": same, "value": [columns[name][0] for name in same]}
    curves = results.curves.assign(run=results.curves["run_id"].map(number)).sort_values(["run", "step"], kind="stable")
    tables = {
        "runs.csv": {name: texts for name, texts in columns.items() if name not in same},
        "common.csv": common,
        "curves.csv": {
            name: _numbers(curves[name], _curve_digits(name)) for name in ("run", *results.curves.columns[1:])
        },
        "episodes.csv": _episode_columns(results.episodes, number),
        "trajectories.csv": _trajectory_columns(trajectories, number),
    }
    return {name: _csv(table) for name, table in tables.items()}


def _run_texts(name: str, values: pd.Series) -> list[str]:
    if name.startswith("config."):  # as MLflow has parameters
        return [without_paths("None" if pd.isna(value) else str(value)) for value in values.astype(object)]
    if name == "git_dirty":
        return ["" if pd.isna(value) else str(bool(value)).lower() for value in values]
    if name in ("started", "ended"):
        return ["" if pd.isna(value) else f"{value.strftime(TIME)[:-4]}Z" for value in values]
    if pd.api.types.is_numeric_dtype(values.dtype):
        return _numbers(values, DIGITS)
    return ["" if pd.isna(value) else without_paths(str(value)) for value in values]


def _numbers(values: pd.Series, digits: int) -> list[str]:
    if pd.api.types.is_float_dtype(values.dtype):
        return ["" if np.isnan(value) else f"{value:.{digits}g}" for value in values.tolist()]
    return ["" if pd.isna(value) else str(value) for value in values.tolist()]


def _curve_digits(name: str) -> int:
    return DIGITS if CURVE_BOUNDS.get(name) == SHARE else CURVE_DIGITS


def _episode_columns(episodes: pd.DataFrame, number: Mapping[str, int]) -> Columns:
    """Return the final episodes, a row for each stretch of consecutive scenes."""
    certified = episodes.loc[episodes["phase"] == "certified", "run_id"].value_counts()
    final = episodes[episodes["phase"] == "final"]
    letters = np.array(list(LETTERS))
    found: Columns = {name: [] for name in EPISODE_COLUMNS}
    for run_id, rows in final.groupby("run_id", observed=True, sort=False):
        step, scene = rows["step"].to_numpy(), rows["scene"].to_numpy()
        ends = np.flatnonzero((np.diff(scene) != 1) | (np.diff(step) != 0)) + 1
        for part in np.split(np.arange(len(rows)), ends):
            outcomes = _counted("".join(letters[rows["outcome"].cat.codes.to_numpy()[part]]))
            tried = certified.get(run_id, 0) if part[0] == 0 else 0
            row = (number[str(run_id)], step[part[0]], scene[part[0]], outcomes, tried)
            for name, value in zip(EPISODE_COLUMNS, row, strict=True):
                found[name].append(str(value))
    return found


def _counted(letters: str) -> str:
    """Return letters with how many times each is repeated: `sssc` as `s3c`."""
    return re.sub(r"(.)\1+", lambda found: f"{found[1]}{len(found[0])}", letters)


def _trajectory_columns(trajectories: Mapping[str, pd.DataFrame], number: Mapping[str, int]) -> Columns:
    found: Columns = {name: [] for name in TRAJECTORY_COLUMNS}
    for run_id in sorted(trajectories, key=lambda one: number[one]):
        for scene, rows in trajectories[run_id].groupby("scene"):
            steps = rows["step"].tolist()
            every = steps[1] - steps[0] if len(steps) > 1 else 0
            if steps != recorded_steps(steps[-1], every):
                raise ValueError(f"run {run_id}, scene {scene}: its positions are not evenly spaced up to the end")
            lists = [_differences(rows[name]) for name in UNITS.values()]
            for name, value in zip(TRAJECTORY_COLUMNS, (number[run_id], scene, steps[-1], every, *lists), strict=True):
                found[name].append(str(value))
    return found


def _differences(values: pd.Series) -> str:
    hundredths = np.round(values.to_numpy(dtype="float64") * 100).astype("int64")
    return " ".join(map(str, np.diff(hundredths, prepend=0).tolist()))


def recorded_steps(end: int, every: int) -> list[int]:
    """Return the steps of an episode that are kept: every `every`th, none where that is 0, and the last."""
    return [*(range(0, end, every) if every else ()), end]


def _csv(columns: Mapping[str, Sequence[str]]) -> str:
    rows = [list(columns), *zip(*columns.values(), strict=True)]
    return "".join(",".join(map(_field, row)) + "\n" for row in rows)


def _field(word: str) -> str:
    # Not csv.writer: with lines that end with \n it leaves \r without quotes, which its own reader ends a line at.
    return '"' + word.replace('"', '""') + '"' if any(sign in word for sign in ',"\r\n') else word

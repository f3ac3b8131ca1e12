"""Parsers of the CSV files of an export, into the frames of `Results`."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from csv import Error as CSVError
from csv import reader
from io import StringIO
from pathlib import Path
from reprlib import repr as shortened
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from parking_exp.config.schema import TRAINING_SCENES_START
from parking_exp.errors import ResultsError
from parking_exp.evaluation.metrics import DTYPES
from parking_exp.results.dtypes import column, flags, text, typed
from parking_exp.results.export_tables import LETTERS, TIME, UNITS, Columns, recorded_steps
from parking_exp.results.frames import CONFIGURED, COST, CURVE_COLUMNS, FINAL, RUN_COLUMNS, STATUSES
from parking_exp.results.recordings import EPISODES, NULLABLE, TRAJECTORIES

Frame = TypeVar("Frame")


def read_tables(
    folder: Path, texts: Mapping[str, str]
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Return runs, curves, episodes and recordings of an export's texts.

    Raises:
        ResultsError: one of them is damaged.
    """

    def parsed(name: str, parse: Callable[[Columns], Frame]) -> Frame:
        try:
            return parse(_columns(texts[name]))
        except (CSVError, ValueError, KeyError, OverflowError) as error:
            what = f"it has no column {error}" if isinstance(error, KeyError) else str(error).partition("\n")[0]
            raise ResultsError(f"{folder / name} can't be read: {what}") from error

    common = parsed("common.csv", lambda found: dict(zip(found["column"], found["value"], strict=True)))
    runs = parsed("runs.csv", lambda found: _runs(found, common))
    ids = runs["run_id"].to_numpy()
    return (
        runs,
        parsed("curves.csv", lambda found: _curves(found, ids)),
        parsed("episodes.csv", lambda found: _episodes(found, ids)),
        parsed("trajectories.csv", lambda found: _recordings(found, ids)),
    )


def _columns(content: str) -> Columns:
    """Return the columns of a CSV text by name.

    Raises:
        csv.Error, ValueError: it is none.
    """
    if not content.endswith("\n"):
        raise ValueError("it is cut off")
    header, *rows = reader(StringIO(content, newline=""), strict=True)
    for line, row in enumerate(rows, 2):
        if len(row) != len(header):
            raise ValueError(f"row {line} has {len(row)} values for {len(header)} columns")
    return {name: [row[place] for row in rows] for place, name in enumerate(header)}


def _runs(found: Columns, common: Mapping[str, str]) -> pd.DataFrame:
    n = len(found["run_id"])
    everything: Columns = {**{name: [value] * n for name, value in common.items()}, **found}
    everything |= dict.fromkeys(("run_dir", "artifact_uri"), [""] * n)
    versions, keys = (sorted(name for name in everything if name.startswith(what)) for what in ("version.", "config."))
    runs = pd.DataFrame({name: _run_column(name, everything[name]) for name in (*RUN_COLUMNS, *versions, *keys)})
    if runs.empty or runs["run_id"].duplicated().any():
        raise ValueError("it has no runs, or one of them twice")
    return runs


def _run_column(name: str, words: Sequence[str]) -> Any:
    if name.startswith("config."):
        return column([typed(word) for word in words])
    if name in CONFIGURED.values():
        return pd.array([int(word) if word else None for word in words], dtype="Int64")
    if name in ("seed", "steps"):
        return _integers(words)
    if name in (*FINAL.values(), *COST.values()):
        return _floats(words)
    if name in ("started", "ended"):
        known = pd.Series([word or None for word in words], dtype=object)
        return pd.to_datetime(known, format=TIME, utc=True).dt.as_unit("ms")
    if name == "git_dirty":
        return flags(words)
    if name == "status":
        if unknown := sorted(set(words) - set(STATUSES)):
            raise ValueError(f"there is no status {unknown[0]!r}")
        return pd.Categorical(list(words), STATUSES)
    return text(word or None for word in words)


def _curves(found: Columns, ids: np.ndarray) -> pd.DataFrame:
    columns = {
        "run_id": text(_run_ids(found, ids)),
        "step": _integers(found["step"]),
        **{name: _floats(found[name]) for name in CURVE_COLUMNS[2:]},
    }
    return pd.DataFrame(columns).sort_values(["run_id", "step"], ignore_index=True)


def _episodes(found: Columns, ids: np.ndarray) -> pd.DataFrame:
    counted = [_counts(word) for word in found["outcomes"]]
    lengths = [sum(count for _, count in one) for one in counted]
    first = _scenes(found["first_scene"], lengths)
    codes = [code for one in counted for code, count in one for _ in range(count)]
    scenes = np.concatenate([np.arange(0), *(np.arange(a, a + n) for a, n in zip(first, lengths, strict=True))])
    frame = pd.DataFrame(
        {
            "run_id": pd.Categorical(np.repeat(_run_ids(found, ids), lengths), pd.Index(ids, dtype="str")),
            "phase": pd.Categorical(["final"] * len(codes), EPISODES["phase"].categories),
            "step": np.repeat(_integers(found["step"]), lengths),
            "scene": scenes.astype("int64"),
            "outcome": pd.Categorical.from_codes(codes, dtype=EPISODES["outcome"]),
        }
    )
    lost = {name: NULLABLE.get(dtype, dtype) for name, dtype in DTYPES.items()}
    return frame.reindex(columns=["run_id", *EPISODES]).astype(lost)


def _counts(word: str) -> list[tuple[int, int]]:
    """Return which outcome comes how many times in a row: `s3c` is three successes and a crash."""
    if not re.fullmatch(rf"(?:[{LETTERS}](?:[1-9]\d{{0,8}})?)+", word):
        raise ValueError(f"there are no such outcomes: {shortened(word)}")
    return [(LETTERS.index(part[1]), int(part[2] or 1)) for part in re.finditer(r"(\D)(\d*)", word)]


def _recordings(found: Columns, ids: np.ndarray) -> pd.DataFrame:
    ends, every = _integers(found["steps"]).tolist(), _integers(found["every"]).tolist()
    scenes = _scenes(found["scene"], [1] * len(ends))
    lists = {name: [word.split(" ") for word in found[name]] for name in UNITS}
    lengths = [(len(range(0, end, one)) if one > 0 else 0) + 1 for end, one in zip(ends, every, strict=True)]
    if any([len(one) for one in lists[name]] != lengths for name in UNITS):
        raise ValueError("it has trajectories with more or fewer positions than steps")
    steps = [step for end, one in zip(ends, every, strict=True) for step in recorded_steps(end, max(0, one))]
    coordinates = {
        UNITS[name]: np.concatenate([np.arange(0), *(np.cumsum(_integers(one)) for one in words)]) / 100
        for name, words in lists.items()
    }
    columns = {"scene": np.repeat(scenes, lengths), "step": np.array(steps), **coordinates}
    typed_columns: dict[str, Any] = {
        name: pd.Series(columns.get(name, np.full(sum(lengths), np.nan))).astype(dtype)
        for name, dtype in TRAJECTORIES.items()
    }
    return pd.DataFrame({"run_id": text(np.repeat(_run_ids(found, ids), lengths).tolist()), **typed_columns})


def _run_ids(found: Columns, ids: np.ndarray) -> np.ndarray:
    rows = _integers(found["run"])
    if ((rows < 0) | (rows >= len(ids))).any():
        raise ValueError("it has rows of runs that there are not")
    return ids[rows]


def _scenes(words: Sequence[str], lengths: Iterable[int]) -> np.ndarray:
    scenes = _integers(words)
    if ((scenes < 0) | (scenes + np.array(list(lengths), dtype="int64") > TRAINING_SCENES_START)).any():
        raise ValueError("it has scenes that there are not")
    return scenes


def _integers(words: Sequence[str]) -> np.ndarray:
    return np.array([int(word) for word in words], dtype="int64")


def _floats(words: Sequence[str]) -> np.ndarray:
    return np.array([float(word) if word else np.nan for word in words], dtype="float64")

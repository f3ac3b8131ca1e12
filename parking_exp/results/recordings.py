"""Parsers of `episodes.csv` and `trajectories.npz`, into frames."""

import io
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.config.schema import TRAINING_SCENES_START
from parking_exp.envs.outcomes import OUTCOMES
from parking_exp.evaluation.metrics import DTYPES
from parking_exp.evaluation.trajectories import CAR_COLUMNS

PHASES = ("eval", "final", "certified")
EPISODES: dict[str, Any] = {
    "phase": pd.CategoricalDtype([*PHASES]),
    "step": "int64",
    "scene": "int64",
    "outcome": pd.CategoricalDtype([*OUTCOMES]),
    **DTYPES,
}
"""Columns of `Results.episodes` after the run id, and their types."""
REQUIRED = ("phase", "step", "scene", "outcome")
"""Columns without which a row means nothing. Others may be missing in runs of earlier versions."""
NULLABLE = {"bool": "boolean", "int64": "Int64"}
TRAJECTORIES: dict[str, Any] = {"scene": "int64", "step": "int64", **dict.fromkeys(CAR_COLUMNS, "float32")}


def read_episodes(texts: Mapping[str, bytes], run_ids: Sequence[str]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return the episodes of many runs as one table, and what is wrong with the texts that are none.

    Texts with the same header are parsed as one: it is the number of parses that takes time. Where a text lacks a
    column of EPISODES, its rows have none of these values, and the column has the nullable type. Columns that
    EPISODES does not have are left out.

    Args:
        texts: content of `episodes.csv` by run id.
        run_ids: the categories of the column `run_id`, in the order of the table.
    """
    alike: dict[bytes, list[str]] = {}
    for run_id, content in texts.items():
        alike.setdefault(content.partition(b"\n")[0], []).append(run_id)
    codes = {run_id: code for code, run_id in enumerate(run_ids)}
    problems: dict[str, str] = {}
    tables, order, lengths = [_empty(EPISODES)], [], []
    for group in alike.values():
        for several, their_lengths, table in _parsed(group, texts, problems):
            tables.append(table)
            order += [codes[run_id] for run_id in several]
            lengths += their_lengths
    joined = pd.concat(tables[1:] or tables, ignore_index=True)
    rows = np.repeat(np.array(order, dtype="int64"), lengths)
    categories = pd.Index(list(run_ids), dtype="str")
    joined.insert(0, "run_id", pd.Series(pd.Categorical.from_codes(rows, categories)))
    if order != sorted(order):
        joined = joined.sort_values("run_id", kind="stable", ignore_index=True)
    return joined, problems


def read_trajectories(content: bytes | None) -> pd.DataFrame:
    """Return the rows of `trajectories.npz`, none for None.

    Raises:
        ValueError: the content is no such file.
    """
    if content is None:
        return _empty(TRAJECTORIES)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            stored = {name: arrays[name] for name in ("scene", "length", *CAR_COLUMNS)}
    except (AttributeError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"it is no recording of episodes ({error})") from error
    lengths = stored.pop("length")
    if len({lengths.sum(), *(len(stored[name]) for name in CAR_COLUMNS)}) > 1 or len(stored["scene"]) != len(lengths):
        raise ValueError("its arrays are not of the same episodes")
    steps = np.concatenate([np.arange(0), *map(np.arange, lengths)])
    if not all(np.isfinite(stored[name]).all() for name in CAR_COLUMNS):
        raise ValueError("it has places that are no numbers")
    columns = {**stored, "scene": np.repeat(stored["scene"], lengths), "step": steps}
    return pd.DataFrame({name: columns[name].astype(dtype) for name, dtype in TRAJECTORIES.items()})


def _parsed(
    run_ids: Sequence[str], texts: Mapping[str, bytes], problems: dict[str, str]
) -> Iterator[tuple[Sequence[str], list[int], pd.DataFrame]]:
    """Yield (run ids, number of rows of each, rows) of texts with the same header; singly if need be."""
    try:
        table, lengths = _parse([texts[run_id] for run_id in run_ids])
    except ValueError as error:
        if len(run_ids) == 1:
            problems[run_ids[0]] = str(error).strip().partition("\n")[0]
            return
        for run_id in run_ids:
            yield from _parsed([run_id], texts, problems)
        return
    yield run_ids, lengths, table


def _parse(texts: Sequence[bytes]) -> tuple[pd.DataFrame, list[int]]:
    """Return the rows of CSV texts with the same header, and how many each has.

    Raises:
        ValueError: one of them is not a whole table of episodes.
    """
    if not all(text.endswith(b"\n") for text in texts):
        raise ValueError("it is cut off")
    header = texts[0].partition(b"\n")[0] + b"\n"
    names = {name.strip('"') for name in header.decode(errors="replace").strip().split(",")}
    if absent := [name for name in REQUIRED if name not in names]:
        raise ValueError(f"it has no column {' and no column '.join(absent)}")
    columns = [name for name in EPISODES if name in names]
    bodies = [text[len(header) :] for text in texts]
    lengths = [body.count(b"\n") for body in bodies]
    table = pd.read_csv(io.BytesIO(b"".join([header, *bodies])), dtype=EPISODES, usecols=columns)
    if len(table) != sum(lengths) or table[["phase", "outcome"]].isna().any(axis=None):
        raise ValueError("it has rows that are no episodes")
    if not table["scene"].between(0, TRAINING_SCENES_START - 1).all():
        raise ValueError("it has scenes that there are not")
    without = {name: NULLABLE.get(dtype, dtype) for name, dtype in EPISODES.items() if name not in names}
    return table.reindex(columns=list(EPISODES)).astype(without), lengths


def _empty(dtypes: Mapping[str, Any]) -> pd.DataFrame:
    return pd.DataFrame({name: pd.Series(dtype=dtype) for name, dtype in dtypes.items()})

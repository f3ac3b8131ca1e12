"""Parsers of `episodes.csv` and `trajectories.npz`, into frames."""

import io
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.config.schema import TRAINING_SCENES_START
from parking_exp.envs.outcomes import OUTCOMES
from parking_exp.evaluation.metrics import DTYPES
from parking_exp.evaluation.trajectories import CAR_COLUMNS

PHASES = ("eval", "final", "certified")
REQUIRED: dict[str, Any] = {
    "phase": pd.CategoricalDtype([*PHASES]),
    "step": "int64",
    "scene": "int64",
    "outcome": pd.CategoricalDtype([*OUTCOMES]),
}
"""Columns of episodes without which a row means nothing; runs made before a metric was added lack others."""
EPISODES: dict[str, Any] = {**REQUIRED, **DTYPES}
"""Columns of `Results.episodes` after the run id, and their types."""
TRAJECTORIES: dict[str, Any] = {"scene": "int64", "step": "int64", **dict.fromkeys(CAR_COLUMNS, "float32")}


def read_episodes(texts: Mapping[str, bytes], run_ids: Sequence[str]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return the episodes of many runs as one table, and what is wrong with the texts that can't be read.

    Columns that EPISODES does not have are left out; those that a text does not have are missing in its rows.

    Args:
        texts: content of `episodes.csv` by run id.
        run_ids: the categories of the column `run_id`, in the order of the table.
    """
    tables, problems = [_empty({"run_id": _categories(run_ids), **EPISODES})], dict[str, str]()

    def parse(alike: Mapping[str, bytes]) -> None:
        try:
            tables.append(_parse(alike, run_ids))
        except ValueError as error:
            if len(alike) == 1:
                problems[next(iter(alike))] = str(error).strip().partition("\n")[0]
            else:
                for run_id, content in alike.items():
                    parse({run_id: content})

    # Texts with the same header are parsed as one: the number of parses is what takes time.
    headers = {run_id: content.partition(b"\n")[0] for run_id, content in texts.items()}
    for header in dict.fromkeys(headers.values()):
        parse({run_id: content for run_id, content in texts.items() if headers[run_id] == header})
    joined = pd.concat(tables[1:] or tables, ignore_index=True).reindex(columns=["run_id", *EPISODES])
    return joined.sort_values("run_id", kind="stable", ignore_index=True), problems


def read_trajectories(content: bytes | None) -> pd.DataFrame:
    """Return the rows of `trajectories.npz`, none for None.

    Raises:
        ValueError: the content is no such file.
    """
    if content is None:
        return _empty(TRAJECTORIES)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            scene, lengths = arrays["scene"], arrays["length"]
            cars = {name: arrays[name] for name in CAR_COLUMNS}
    except (AttributeError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"it is no recording of episodes ({error})") from error
    if {lengths.sum()} != {len(values) for values in cars.values()} or len(scene) != len(lengths):
        raise ValueError("its arrays are not of the same episodes")
    if not all(np.isfinite(values).all() for values in cars.values()):
        raise ValueError("it has positions that are not finite")
    steps = np.concatenate([np.arange(0), *map(np.arange, lengths)])
    return pd.DataFrame({"scene": np.repeat(scene, lengths), "step": steps, **cars}).astype(TRAJECTORIES)


def _parse(texts: Mapping[str, bytes], run_ids: Sequence[str]) -> pd.DataFrame:
    """Return the rows of CSV texts with the same header, by run id.

    Raises:
        ValueError: one of them is not a whole table of episodes.
    """
    if not all(text.endswith(b"\n") for text in texts.values()):
        raise ValueError("the file is truncated")
    header = next(iter(texts.values())).partition(b"\n")[0] + b"\n"
    bodies = [text[len(header) :] for text in texts.values()]
    content = io.BytesIO(b"".join([header, *bodies]))
    table = pd.read_csv(content, dtype=EPISODES, usecols=lambda name: name in EPISODES)
    if absent := [name for name in REQUIRED if name not in table]:
        raise ValueError(f"it has no column {absent[0]}")
    rows = [body.count(b"\n") for body in bodies]
    scenes = table["scene"].between(0, TRAINING_SCENES_START - 1)
    if len(table) != sum(rows) or table[[*REQUIRED]].isna().any(axis=None) or not scenes.all():
        raise ValueError("it has rows that are no episodes")
    codes = {run_id: code for code, run_id in enumerate(run_ids)}
    owners = np.repeat([codes[run_id] for run_id in texts], rows)
    return table.assign(run_id=pd.Categorical.from_codes(owners, dtype=_categories(run_ids)))


def _categories(run_ids: Sequence[str]) -> pd.CategoricalDtype:
    return pd.CategoricalDtype(pd.Index(list(run_ids), dtype="str"))


def _empty(dtypes: Mapping[str, Any]) -> pd.DataFrame:
    return pd.DataFrame({name: pd.Series(dtype=dtype) for name, dtype in dtypes.items()})

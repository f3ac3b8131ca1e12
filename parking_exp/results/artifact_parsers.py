"""Parsers of a run's files, as the store has them: config to settings, metrics to curves, episodes
and their paths to frames.
"""

import io
import json
import re
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.config.settings import FlatConfig, flatten_config
from parking_exp.config_model import TRAINING_SEEDS_START
from parking_exp.runs.foreign_files import parse_plain_yaml
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.tasks.registry import DTYPES, METRICS, OUTCOMES, added_metrics

CURVE_COLUMNS = {f"eval/{metric.key}": metric.key for metric in METRICS if metric.in_curves}
CURVE_KEYS = {**CURVE_COLUMNS, "time/cpu_s": "cpu_s", "buffer/real_share": "real_share"}
CURVE_TYPES: dict[str, Any] = {
    "run_id": "str",
    "step": "int64",
    **dict.fromkeys(CURVE_KEYS.values(), "float64"),
}
"""Columns of `Results.curves` before metrics of users, and their types."""
REQUIRED_TYPES: dict[str, Any] = {
    "phase": pd.CategoricalDtype(["eval", "final", "certified"]),
    "step": "int64",
    EPISODE_SEED: "int64",
    "outcome": pd.CategoricalDtype([*OUTCOMES]),
}
"""Columns of episodes that every task has; each task lacks some of the others."""
EPISODE_TYPES: dict[str, Any] = {**REQUIRED_TYPES, **DTYPES}
"""Columns of `Results.episodes` between the run id and metrics of users, and their types."""
CATEGORY_TYPES = {
    name: kind for name, kind in EPISODE_TYPES.items() if isinstance(kind, pd.CategoricalDtype)
}
PATH_TYPES: dict[str, Any] = {EPISODE_SEED: "int64", "step": "int64"}
"""Columns of `Results.paths` between the run id and positions, and their types."""
NUMBER_TYPES = {name: kind for name, kind in EPISODE_TYPES.items() if name not in CATEGORY_TYPES}


SEED_LINE = re.compile(rb"^seed: (\d{1,10})$", re.MULTILINE)


def config_reader() -> Callable[[bytes], FlatConfig]:
    """Return a parser of the content of a `config.yaml`; any error means that it is damaged.

    Runs of a cell differ in the line of their seed; what they share is parsed once, since YAML is
    slow.
    """

    @cache
    def read_shared(content: bytes) -> FlatConfig:
        config = parse_plain_yaml(content)
        if not isinstance(config, dict):
            raise ValueError("it is not a mapping")
        return flatten_config(config)

    def read(content: bytes) -> FlatConfig:
        seed = SEED_LINE.search(content)
        if seed is None:
            return read_shared(content)
        shared = content[: seed.start()] + content[seed.end() :]
        return {**read_shared(shared), "seed": int(seed[1])}

    return read


def read_points(log: bytes) -> list[dict[str, Any]]:
    """Return the points of curves in a `metrics.jsonl`, by step; any error means it is damaged."""
    points: dict[int, dict[str, Any]] = {}
    for record in map(json.loads, log.splitlines()):
        values = {}
        for key, value in record["metrics"].items():
            column = _curve_column(key)
            if column is not None:
                values[column] = float(value)
        if values:
            # Conversion raises for what a column of int64 can't hold.
            step = int(np.int64(record["step"]))
            points.setdefault(step, {"step": step}).update(values)
    return list(points.values())


@cache
def _curve_column(key: str) -> str | None:
    """Return the column of a metric in `Results.curves`; None if it has none."""
    if key in CURVE_KEYS:
        return CURVE_KEYS[key]
    added = added_metrics([key], "eval/")
    return added[0] if added else None


def read_episodes(table: bytes) -> pd.DataFrame:
    """Return the rows of an `episodes.csv`, with text for categories.

    Columns that EPISODE_TYPES does not have are metrics of users, if they have numbers.

    Raises:
        ValueError: it is damaged.
    """
    episodes = pd.read_csv(io.BytesIO(table), dtype=NUMBER_TYPES)
    numbers = episodes.select_dtypes(["number", "bool"])
    known = [name for name in EPISODE_TYPES if name in episodes]
    added = [name for name in numbers.columns.difference(["run_id", *known]) if name.isidentifier()]
    episodes = episodes[[*known, *added]]
    for name in REQUIRED_TYPES:
        if name not in episodes:
            raise ValueError(f"it has no column {name}")
    is_known = episodes[EPISODE_SEED].between(0, TRAINING_SEEDS_START - 1)
    for name, kind in CATEGORY_TYPES.items():
        is_known &= episodes[name].isin(kind.categories)
    if not is_known.all():
        raise ValueError("it has rows that are not episodes")
    return episodes


def read_paths(table: bytes) -> pd.DataFrame:
    """Return the rows of a `paths.csv.gz`.

    Raises:
        ValueError: it is damaged, or has anything but finite numbers.
    """
    types = defaultdict(lambda: "float64", PATH_TYPES)
    paths = pd.read_csv(io.BytesIO(table), compression="gzip", dtype=types)
    for name in PATH_TYPES:
        if name not in paths:
            raise ValueError(f"it has no column {name}")
    if not np.isfinite(paths).all(axis=None):
        raise ValueError("some of its rows are not positions")
    return paths

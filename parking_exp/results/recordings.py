"""Parsers of a run's files, as the store has them, into frames: metrics, episodes, trajectories."""

import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.config_model import TRAINING_SEEDS_START
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.tasks.registry import DTYPES, METRICS, OUTCOMES, RECORDED

CURVE = {f"eval/{metric.key}": metric.key for metric in METRICS if metric.in_curves}
FURTHER_CURVE_METRICS = {"time/cpu_s": "cpu_s", "buffer/real_share": "real_share"}
CURVE_TYPES: dict[str, Any] = {
    "run_id": "str",
    "step": "int64",
    **dict.fromkeys([*CURVE.values(), *FURTHER_CURVE_METRICS.values()], "float64"),
}
"""Columns of `Results.curves`, and their types."""
REQUIRED: dict[str, Any] = {
    "phase": pd.CategoricalDtype(["eval", "final", "certified"]),
    "step": "int64",
    EPISODE_SEED: "int64",
    "outcome": pd.CategoricalDtype([*OUTCOMES]),
}
"""Required columns of episodes; runs made before a metric was added lack others."""
EPISODES: dict[str, Any] = {**REQUIRED, **DTYPES}
"""Columns of `Results.episodes` after the run id, and their types."""
TRAJECTORIES: dict[str, Any] = {EPISODE_SEED: "int64", "step": "int64", **dict.fromkeys(RECORDED, "float32")}


def read_curves(logs: Mapping[str, bytes]) -> tuple[pd.DataFrame, dict[str, int], dict[str, str]]:
    """Return the curves of many runs, their last steps, and what is wrong with the logs that can't be read.

    Args:
        logs: content of `metrics.jsonl` by run id.
    """
    names = {**CURVE, **FURTHER_CURVE_METRICS}
    points = dict[tuple[str, int], dict[str, Any]]()
    steps, problems = dict[str, int](), dict[str, str]()
    for run_id, content in logs.items():
        try:
            for record in map(json.loads, content.splitlines()):
                values = {names[key]: float(value) for key, value in record["metrics"].items() if key in names}
                if values:
                    step = int(np.int64(record["step"]))
                    points.setdefault((run_id, step), {"run_id": run_id, "step": step}).update(values)
                    steps[run_id] = max(step, steps.get(run_id, 0))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            problems[run_id] = "metrics.jsonl can't be read: it is damaged"
    evaluated = [point for point in points.values() if any(name in point for name in CURVE.values())]
    curves = pd.DataFrame(evaluated, columns=[*CURVE_TYPES]).astype(CURVE_TYPES)
    return curves.sort_values(["run_id", "step"], ignore_index=True), steps, problems


def read_episodes(tables: Mapping[str, bytes], run_ids: Sequence[str]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return the episodes of many runs as one table, and what is wrong with the texts that can't be read.

    Columns that EPISODES does not have are left out; those that a text does not have are missing in its rows.

    Args:
        tables: content of `episodes.csv` by run id.
        run_ids: the categories of the column `run_id`, in the order of the table.
    """
    frames, problems = [], dict[str, str]()
    # Tables with the same header are parsed as one: the number of parses is what takes time.
    by_header: dict[bytes, dict[str, bytes]] = {}
    for run_id, content in tables.items():
        by_header.setdefault(content.partition(b"\n")[0], {})[run_id] = content
    batches = list(by_header.values())
    for batch in batches:
        try:
            frames.append(_parse(batch))
        except ValueError as error:
            if len(batch) == 1:
                reason = str(error).strip().partition("\n")[0]
                problems |= dict.fromkeys(batch, f"episodes.csv can't be read: {reason}")
            else:
                batches += [{run_id: content} for run_id, content in batch.items()]  # find the damaged one
    types = {"run_id": pd.CategoricalDtype(pd.Index(list(run_ids), dtype="str")), **EPISODES}
    if not frames:
        return empty_frame(types), problems
    episodes = pd.concat(frames, ignore_index=True).reindex(columns=[*types]).astype({"run_id": types["run_id"]})
    return episodes.sort_values("run_id", kind="stable", ignore_index=True), problems


def read_trajectories(content: bytes | None) -> pd.DataFrame:
    """Return the rows of `trajectories.npz`, none for None.

    Raises:
        Exception: of any class, if the content is not such a file.
    """
    if content is None:
        return empty_frame(TRAJECTORIES)
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        lengths, columns = arrays["length"], {name: arrays[name] for name in RECORDED}
        # Checked before use: the lengths of a file from elsewhere could ask for any amount of memory.
        n_rows, finite = len(columns[RECORDED[0]]), all(np.isfinite(column).all() for column in columns.values())
        if not finite or (lengths < 0).any() or (lengths > n_rows).any() or lengths.sum() != n_rows:
            raise ValueError("its rows are not those of trajectories")
        steps = np.concatenate([np.arange(0), *map(np.arange, lengths)])
        rows = pd.DataFrame({EPISODE_SEED: np.repeat(arrays[EPISODE_SEED], lengths), "step": steps, **columns})
    return rows.astype(TRAJECTORIES)


def empty_frame(types: Mapping[str, Any]) -> pd.DataFrame:
    """Return a frame without rows."""
    return pd.DataFrame(columns=[*types]).astype(types)


def _parse(tables: Mapping[str, bytes]) -> pd.DataFrame:
    """Return the rows of CSV texts with the same header, with the run id of each."""
    if not all(text.endswith(b"\n") for text in tables.values()):
        raise ValueError("the file is truncated")
    header = next(iter(tables.values())).partition(b"\n")[0] + b"\n"
    bodies = [text.removeprefix(header) for text in tables.values()]
    table = pd.read_csv(io.BytesIO(header + b"".join(bodies)), dtype=EPISODES, usecols=lambda name: name in EPISODES)
    if absent := [name for name in REQUIRED if name not in table]:
        raise ValueError(f"it has no column {absent[0]}")
    n_rows = [body.count(b"\n") for body in bodies]
    is_seed = table[EPISODE_SEED].between(0, TRAINING_SEEDS_START - 1)
    if len(table) != sum(n_rows) or table[[*REQUIRED]].isna().any(axis=None) or not is_seed.all():
        raise ValueError("it has rows that are no episodes")
    return table.assign(run_id=np.repeat(np.array([*tables], dtype=object), n_rows))

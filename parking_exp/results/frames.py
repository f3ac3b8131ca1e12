"""Load the results of runs from an MLflow store."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pandas as pd

from parking_exp.config.paths import database, default_uri, directory_path, refuse_password
from parking_exp.errors import ParkingError, ResultsError, suggestion
from parking_exp.results.recordings import read_curves, read_episodes, read_trajectories
from parking_exp.runs.run_files import TRAJECTORIES_FILE
from parking_exp.tasks.registry import METRICS
from parking_exp.tracking.client import reason
from parking_exp.tracking.store import Store

if TYPE_CHECKING:
    from mlflow.entities import Run

STATUSES = ("done", "running", "failed", "interrupted", "pruned")
# Parameters and metrics, and their columns.
CONFIGURED = {
    "total_timesteps": "total_timesteps",
    "evaluation.final_n_scenes": "n_scenes",
    "evaluation.first_scene": "first_scene",
    "evaluation.n_scenes": "eval_n_scenes",
}
FINAL = {f"final/{metric.key}": metric.run_column for metric in METRICS}
COST = {"time/cpu_s": "cpu_s", "time/wall_s": "wall_s"}

TEXT: Any = "str" if int(pd.__version__.partition(".")[0]) >= 3 else object
RUN_TYPES: dict[str, Any] = {
    **dict.fromkeys(("run_id", "name", "experiment", "cell", "run_key"), TEXT),
    "seed": "int64",
    "status": pd.CategoricalDtype([*STATUSES]),
    "error": TEXT,
    **dict.fromkeys(CONFIGURED.values(), "Int64"),
    "steps": "int64",
    **dict.fromkeys([*FINAL.values(), *COST.values()], "float64"),
    **dict.fromkeys(("started", "ended"), "datetime64[ms, UTC]"),
    **dict.fromkeys(("run_dir", "artifact_uri", "git_commit"), TEXT),
    "git_dirty": "boolean",
    "cpu": TEXT,
}
"""Columns of `runs` before those of versions and config, and their types."""

DOWNLOADS_AT_ONCE = 16
SEED = re.compile(r"\d{1,18}")
# Narrower than what int() and float() accept: 2024_11 is a name.
INTEGER = re.compile(r"[+-]?\d{1,300}")
FLOAT = re.compile(r"[+-]?(?!\d+$)(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?inf|nan", re.IGNORECASE)
TAGS = ("cell", "seed", "run_key", "run_dir", "status")
"""Tags of every run of this package; other runs are ignored."""


@dataclass(frozen=True, eq=False)
class Results:
    """Runs of a store and what they logged, as the frames that `help(parking_exp.results)` describes."""

    runs: pd.DataFrame
    curves: pd.DataFrame
    episodes: pd.DataFrame
    uri: str  # the store
    problems: tuple[str, ...] = ()  # a sentence for each thing that is missing or broken
    ignored: int = 0  # number of runs by other programs
    store: Store | None = None  # to read trajectories from

    def __repr__(self) -> str:
        sizes = ", ".join(f"{len(getattr(self, name))} {name}" for name in ("runs", "curves", "episodes"))
        return f"<Results of {self.uri}: rows of {sizes}; {len(self.problems)} problems>"

    def trajectories(self, run_id: str) -> pd.DataFrame:
        """Return what a run recorded of final episodes: one row per step, the start (step 0) included.

        Columns are those of the episode's seed, step (int64), x_m, y_m, heading_rad, speed_mps (float32), of parking-v0
        alone. A run without a recording has none.

        Raises:
            ResultsError: there is no such run, or its recording can't be read.
        """
        self._check_run_id(run_id)
        places = self.runs.loc[self.runs["run_id"] == run_id, "artifact_uri"]
        with _as_results_error(f"run {run_id}: {TRAJECTORIES_FILE} can't be read"):
            stored = self.store.artifact(run_id, places.iloc[0], TRAJECTORIES_FILE) if self.store else None
            return read_trajectories(stored)

    def _check_run_id(self, run_id: str) -> None:
        if run_id not in set(self.runs["run_id"]):
            hint = suggestion(run_id, self.runs["run_id"])
            raise ResultsError(f"run_id={run_id}: there is no such run{hint}")


def load(
    experiments: str | Iterable[str] | None = None, *, uri: str | None = None, output_dir: str | Path = "outputs"
) -> Results:
    """Read runs from a store.

    Args:
        experiments: name of one, or names; None for all.
        uri: any MLflow tracking URI; None for the embedded store of `output_dir`.
        output_dir: where runs are.

    Raises:
        ConfigError: `uri` contains a password.
        ResultsError: there is no such store, it can't be read, there is no such experiment, or it has no runs.
    """
    folder = directory_path(output_dir)
    return read_store(Store(refuse_password(uri), None) if uri else Store(default_uri(folder), folder), experiments)


def read_store(store: Store, experiments: str | Iterable[str] | None) -> Results:
    """Read runs from a store; see `load`."""
    if (path := database(store.uri)) is not None and not path.is_file():
        raise ResultsError(f"there is no store {path}; train something first, or name another output_dir or store")
    with _as_results_error(f"the store {store.uri} can't be read"):
        ids = _chosen(store, experiments)
        stored = [run for run in store.runs(list(ids.values())) if run.info.lifecycle_stage == "active"]
    kept = [run for run in stored if _is_from_this_package(run)]
    if not kept:
        searched = store.uri if experiments is None else f"experiment={','.join(ids)}"
        others = f", but {len(stored)} by others" if stored else ""
        raise ResultsError(f"{searched}: it has no runs of parking_exp{others}")
    with _as_results_error(f"the store {store.uri} can't be read"):
        runs = _runs(kept, {experiment_id: name for name, experiment_id in ids.items()}, store.run_dir)
    logs, log_problems = _artifacts(store, runs, "metrics.jsonl")
    curves, steps, damaged_logs = read_curves(logs)
    runs["steps"] = runs["run_id"].map(steps).fillna(0).astype("int64")
    tables, table_problems = _artifacts(store, runs[runs["status"] != "running"], "episodes.csv")
    episodes, damaged_tables = read_episodes(tables, runs["run_id"].to_list())
    problems = (
        *_duplicates(runs),
        *_sentences(runs, log_problems | damaged_logs),
        *_sentences(runs, table_problems | damaged_tables),
    )
    return Results(runs, curves, episodes, store.uri, problems, len(stored) - len(kept), store)


@contextmanager
def _as_results_error(what: str) -> Iterator[None]:
    """Turn any error of a store or its files into a ResultsError."""
    try:
        yield
    except ParkingError:
        raise
    except Exception as error:
        raise ResultsError(f"{what}: {reason(error)}") from error


def _chosen(store: Store, experiments: str | Iterable[str] | None) -> dict[str, str]:
    ids = store.experiments()
    if experiments is None:
        return ids
    names = [experiments] if isinstance(experiments, str) else list(experiments)
    for name in names:
        if name not in ids:
            hint = suggestion(name, set(ids) - {"Default"})
            raise ResultsError(f"experiment={name}: there is no such experiment in {store.uri}{hint}")
    return {name: ids[name] for name in names}


def _is_from_this_package(run: "Run") -> bool:
    tags = run.data.tags
    return all(name in tags for name in TAGS) and tags["status"] in STATUSES and bool(SEED.fullmatch(tags["seed"]))


@lru_cache(maxsize=100_000)
def parse_value(text: str | None) -> Any:
    """Return the value that a parameter is the text of: None, a bool, a number. Lists, mappings and words stay text."""
    if text in (None, "None", "True", "False"):
        return {"True": True, "False": False}.get(text or "")
    if INTEGER.fullmatch(text):
        return int(text)
    return float(text) if FLOAT.fullmatch(text) else text


def _int64(text: str | None) -> int | None:
    """Return the whole number that a text is; None for any other."""
    value = parse_value(text)
    return value if type(value) is int and abs(value) < 2**63 else None


def config_column(texts: Iterable[str | None]) -> pd.Series:
    """Return the typed values of a parameter; where some are None, all stay Python objects."""
    values = [parse_value(text) for text in texts]
    return pd.Series(values, dtype=object if None in values else None)


def _runs(stored: Sequence["Run"], names: Mapping[str, str], run_dir: Callable[["Run"], Path | None]) -> pd.DataFrame:
    """Return `Results.runs` but for `steps`, which the store's files have."""
    rows = []
    for run in stored:
        info, tags, params, metrics = run.info, run.data.tags, run.data.params, run.data.metrics
        final = FINAL if tags["status"] == "done" else {}
        place = run_dir(run)
        rows.append(
            {name: tags.get(name) for name in ("cell", "run_key", "seed", "status", "git_commit", "cpu")}
            | {"run_id": info.run_id, "name": info.run_name, "experiment": names[info.experiment_id]}
            | {"error": tags.get("error") or None, "steps": 0}
            | {column: _int64(params.get(key)) for key, column in CONFIGURED.items()}
            | {column: metrics.get(key) for key, column in (final | COST).items()}
            | {"started": info.start_time, "ended": info.end_time}
            | {"run_dir": str(place) if place else None, "artifact_uri": info.artifact_uri}
            | {"git_dirty": {"true": True, "false": False}.get(tags.get("git_dirty", ""))}
        )
    runs = pd.DataFrame(rows, columns=[*RUN_TYPES], dtype=object)
    for name in ("started", "ended"):
        runs[name] = pd.to_datetime(runs[name].astype("Int64"), unit="ms", utc=True, errors="coerce")
    versions = sorted({name for run in stored for name in run.data.tags if name.startswith("version.")})
    keys = sorted({key for run in stored for key in run.data.params})
    described = {name: pd.Series([run.data.tags.get(name) for run in stored], dtype=TEXT) for name in versions}
    config = {f"config.{key}": config_column(run.data.params.get(key) for run in stored) for key in keys}
    runs = pd.concat([runs.astype(RUN_TYPES), pd.DataFrame(described | config)], axis=1)
    return runs.sort_values(["experiment", "cell", "seed", "started"], ignore_index=True)


def _artifacts(store: Store, runs: pd.DataFrame, name: str) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return an artifact of each run that has it, and what is wrong with the others', by run id."""
    contents, problems = {}, {}

    def fetch(run_id: str, folder_uri: str, status: str) -> None:
        try:
            content = store.artifact(run_id, folder_uri, name)
        except Exception as error:
            problems[run_id] = f"{name} can't be read: {reason(error)}"
            return
        if content is not None:
            contents[run_id] = content
        elif status == "done":  # others may not have come to an evaluation
            problems[run_id] = f"{name} is missing in the store"

    with ThreadPoolExecutor(DOWNLOADS_AT_ONCE) as pool:
        list(pool.map(fetch, runs["run_id"], runs["artifact_uri"], runs["status"]))
    return contents, problems


def _sentences(runs: pd.DataFrame, problems: Mapping[str, str]) -> Iterator[str]:
    for run_id, cell, seed in zip(runs["run_id"], runs["cell"], runs["seed"], strict=True):
        if run_id in problems:
            yield f"run {run_id} ({cell}, seed {seed}): {problems[run_id]}"


def _duplicates(runs: pd.DataFrame) -> Iterator[str]:
    """Yield a sentence for each run that is there more than once, e.g. from two output directories with one store."""
    numbers = runs.groupby(["experiment", "cell", "seed"], sort=False).size()
    for key, number in numbers[numbers > 1].items():
        experiment, cell, seed = cast(tuple[str, str, int], key)
        yield f"{experiment}, {cell}, seed {seed}: {number} runs have this cell and seed"

"""Load the results of runs from an MLflow store."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from parking_exp.config.paths import absolute_path, database_file, default_uri, refuse_password
from parking_exp.config.settings import FlatConfig, Setting
from parking_exp.errors import ParkingError, ResultsError, reason_of_store_failure
from parking_exp.phrases import suggestion
from parking_exp.results.artifact_parsers import (
    CATEGORY_TYPES,
    CURVE_COLUMNS,
    CURVE_TYPES,
    EPISODE_TYPES,
    PATH_TYPES,
    config_reader,
    read_episodes,
    read_paths,
    read_points,
)
from parking_exp.runs.metric_logs import EPISODES_FILE, METRICS_FILE
from parking_exp.runs.run_files import CONFIG_FILE, PATHS_FILE
from parking_exp.tasks.registry import METRICS, added_metrics
from parking_exp.tracking.embedded_store import rebuild_if_unusable
from parking_exp.tracking.store import Store

if TYPE_CHECKING:
    from mlflow.entities import Run

CONFIG_PREFIX = "config."
"""Prefix of the columns of `Results.runs` with the config."""
STATUSES = ("done", "running", "failed", "interrupted")
# Metrics and their columns.
FINAL_COLUMNS = {f"final/{metric.key}": metric.run_column for metric in METRICS}
COST_COLUMNS = {"time/cpu_s": "cpu_s", "time/wall_s": "wall_s"}

TEXT: Any = "str" if int(pd.__version__.partition(".")[0]) >= 3 else object
RUN_TYPES: dict[str, Any] = {
    **dict.fromkeys(("run_id", "experiment", "cell", "run_key"), TEXT),
    "seed": "int64",
    "status": pd.CategoricalDtype([*STATUSES]),
    "error": TEXT,
    "steps": "int64",
    **dict.fromkeys([*FINAL_COLUMNS.values(), *COST_COLUMNS.values()], "float64"),
    **dict.fromkeys(("started", "ended"), "datetime64[ms, UTC]"),
    **dict.fromkeys(("run_dir", "artifact_uri", "git_commit"), TEXT),
    "git_dirty": "boolean",
    "cpu": TEXT,
}
"""Columns of `runs` before metrics of users, versions and config, and their types."""

DOWNLOADS_AT_ONCE = 16
TAGS = ("cell", "seed", "run_key", "run_dir", "status")
"""Tags of every run of this package; other runs are ignored."""
TAG_COLUMNS = ("cell", "run_key", "seed", "status", "error", "git_commit", "git_dirty", "cpu")
"""Tags that are columns of `runs`."""


def _no_paths() -> pd.DataFrame:
    types = {"run_id": TEXT, **PATH_TYPES}
    return pd.DataFrame(columns=[*types]).astype(types)


@dataclass(frozen=True, eq=False)
class Results:
    """Runs of a store and what they logged; `help(parking_exp.results)` describes the frames."""

    runs: pd.DataFrame = field(repr=False)
    curves: pd.DataFrame = field(repr=False)
    episodes: pd.DataFrame = field(repr=False)
    uri: str  # the store, or the folder of an export
    problems: tuple[str, ...] = ()  # a sentence for each thing that is missing or broken
    about: Mapping[str, Any] = field(default_factory=dict)  # report.json of an export
    paths: pd.DataFrame = field(repr=False, default_factory=_no_paths)


def load(
    experiments: str | Iterable[str] | None = None,
    *,
    uri: str | None = None,
    output_dir: str | Path = "outputs",
) -> Results:
    """Read runs from a store.

    Args:
        experiments: name of one, or names; None for all.
        uri: any MLflow tracking URI; None for the embedded store of `output_dir`.
        output_dir: where runs are.

    Raises:
        ConfigError: `uri` contains a password.
        ResultsError: there is no such store, it can't be read, there is no such experiment, or it
            has no runs.
    """
    folder = absolute_path(output_dir)
    store = Store(default_uri(folder), folder)
    if uri:
        store = Store(refuse_password(uri), None)
    return read_store(store, experiments)


def read_store(store: Store, experiments: str | Iterable[str] | None) -> Results:
    """Read runs from a store; see `load`."""
    path = database_file(store.uri)
    if path is not None and not path.is_file():
        raise ResultsError(
            f"there is no store {path}; train something first, or name another output_dir or store"
        )
    with as_results_error(f"the store {store.uri} can't be read"):
        rebuild_if_unusable(store)
        ids = _choose_experiments(store, experiments)
        stored = [run for run in store.runs(ids.values()) if _is_from_this_package(run)]
        if not stored:
            searched = store.uri if experiments is None else f"experiment={','.join(ids)}"
            raise ResultsError(f"{searched}: it has no runs of parking_exp")
        runs = _make_runs(store, stored, ids)

    problems = list(_duplicates(runs))
    configs = _read_files(store, runs, CONFIG_FILE, config_reader(), problems)
    logs = _read_files(store, runs, METRICS_FILE, read_points, problems)
    not_running = runs[runs["status"] != "running"]
    episodes = _read_files(store, not_running, EPISODES_FILE, read_episodes, problems)
    # Figures show one run of a cell. Runs of most tasks have no paths.
    lowest_seeds = runs[runs["status"] == "done"].drop_duplicates(["experiment", "cell"])
    paths = _read_files(store, lowest_seeds, PATHS_FILE, read_paths, problems, optional=True)

    points = _make_points(logs)
    last_steps = points.groupby("run_id")["step"].max()
    runs["steps"] = runs["run_id"].map(last_steps).fillna(0).astype("int64")
    return Results(
        runs=_with_configs(runs, configs),
        curves=_make_curves(points),
        episodes=_make_episodes(episodes, runs["run_id"]),
        uri=store.uri,
        problems=tuple(problems),
        paths=_concatenate(paths, _no_paths()),
    )


def typed_curves(curves: pd.DataFrame) -> pd.DataFrame:
    """Return curves with the columns and types of `Results.curves`."""
    types = CURVE_TYPES | dict.fromkeys(added_metrics(curves.columns), "float64")
    return curves.reindex(columns=[*types]).astype(types)


@contextmanager
def as_results_error(what: str) -> Iterator[None]:
    """Turn any error of a store or its files into a ResultsError."""
    try:
        yield
    except ParkingError:
        raise
    except Exception as error:
        raise ResultsError(f"{what}: {reason_of_store_failure(error)}") from error


def _choose_experiments(store: Store, experiments: str | Iterable[str] | None) -> dict[str, str]:
    ids = store.experiment_ids()
    if experiments is None:
        return ids
    names = [experiments] if isinstance(experiments, str) else list(experiments)
    for name in names:
        if name not in ids:
            store.refuse_deleted(name)
            hint = suggestion(name, set(ids) - {"Default"})
            raise ResultsError(
                f"experiment={name}: there is no such experiment in {store.uri}{hint}"
            )
    return {name: ids[name] for name in names}


def _is_from_this_package(run: "Run") -> bool:
    """Return whether a run that is not deleted is one of this package."""
    tags = run.data.tags
    if run.info.lifecycle_stage != "active" or any(name not in tags for name in TAGS):
        return False
    return tags["status"] in STATUSES and tags["seed"].isdecimal()


def setting_column(values: Sequence[Setting]) -> pd.Series:
    """Return the values of a config key as a column, of Python objects if some are None."""
    dtype = object if None in values else None
    return pd.Series(values, dtype=dtype)


def _make_runs(store: Store, stored: Sequence["Run"], ids: Mapping[str, str]) -> pd.DataFrame:
    """Return `Results.runs` without what comes from files: the config and `steps`."""
    tags = pd.DataFrame([run.data.tags for run in stored])
    metrics = pd.DataFrame([run.data.metrics for run in stored])
    infos = pd.DataFrame([dict(run.info) for run in stored])
    added = added_metrics(metrics.columns, "final/")
    numbers = _final_numbers(metrics, added, is_done=tags["status"] == "done")

    runs = pd.concat([tags.reindex(columns=[*TAG_COLUMNS]), numbers], axis=1)
    runs[["run_id", "artifact_uri"]] = infos[["run_id", "artifact_uri"]]
    runs["experiment"] = infos["experiment_id"].map({value: name for name, value in ids.items()})
    runs["error"] = runs["error"].replace("", None)
    runs["git_dirty"] = runs["git_dirty"].map({"true": True, "false": False})
    run_dirs = pd.Series([store.run_dir(run) for run in stored], dtype=object)
    runs["run_dir"] = run_dirs.map(str, na_action="ignore")
    for column, time in {"started": "start_time", "ended": "end_time"}.items():
        milliseconds = infos[time].astype("Int64")
        runs[column] = pd.to_datetime(milliseconds, unit="ms", utc=True, errors="coerce")
    runs["steps"] = 0
    types = RUN_TYPES | dict.fromkeys(added, "float64")
    runs = runs.reindex(columns=[*types]).astype(types)

    versions = tags.filter(regex=r"^version\.").sort_index(axis="columns").astype(TEXT)
    runs = pd.concat([runs, versions], axis=1)
    return runs.sort_values(["experiment", "cell", "seed", "started"], ignore_index=True)


def _final_numbers(metrics: pd.DataFrame, added: Sequence[str], is_done: pd.Series) -> pd.DataFrame:
    """Return costs and final metrics of runs; only finished runs have final metrics."""
    final = FINAL_COLUMNS | {f"final/{name}": name for name in added}
    columns = COST_COLUMNS | final
    numbers = metrics.reindex(columns=[*columns]).rename(columns=columns)
    numbers.loc[~is_done, [*final.values()]] = np.nan
    return numbers


def config_columns(runs: pd.DataFrame) -> list[str]:
    """Return the names of the columns of `Results.runs` with the config."""
    return [name for name in map(str, runs) if name.startswith(CONFIG_PREFIX)]


def _with_configs(runs: pd.DataFrame, configs: Mapping[str, FlatConfig]) -> pd.DataFrame:
    """Return runs with the columns of their configs, which are given by run id."""
    rows = [configs.get(run_id, {}) for run_id in runs["run_id"]]
    columns = {}
    for key in sorted(set().union(*rows)):
        columns[CONFIG_PREFIX + key] = setting_column([row.get(key) for row in rows])
    return pd.concat([runs, pd.DataFrame(columns)], axis=1)


def _make_points(logs: Mapping[str, Sequence[Mapping[str, Any]]]) -> pd.DataFrame:
    """Return a row for each point in the logs of runs, which are given by run id."""
    rows = []
    for run_id, points in logs.items():
        rows += [{"run_id": run_id, **point} for point in points]
    return typed_curves(pd.DataFrame(rows))


def _make_curves(points: pd.DataFrame) -> pd.DataFrame:
    """Return `Results.curves`: the points that are evaluations."""
    evaluations = points.dropna(how="all", subset=[*CURVE_COLUMNS.values()])
    return evaluations.sort_values(["run_id", "step"], ignore_index=True)


def _make_episodes(tables: Mapping[str, pd.DataFrame], run_ids: pd.Series) -> pd.DataFrame:
    """Return `Results.episodes` from the tables of runs, in the order of all run ids."""
    columns = dict(EPISODE_TYPES)
    for table in tables.values():
        for name, dtype in table.dtypes.items():
            columns.setdefault(str(name), dtype)  # metrics of users

    empty = pd.DataFrame(columns=["run_id", *columns]).astype(columns)
    types = {"run_id": run_category(run_ids), **CATEGORY_TYPES}
    return _concatenate(tables, empty).astype(types)


def _concatenate(tables: Mapping[str, pd.DataFrame], empty: pd.DataFrame) -> pd.DataFrame:
    """Concatenate the tables of runs, given by run id; return `empty` if there are no tables."""
    parts = [table.assign(run_id=run_id) for run_id, table in tables.items()]
    return pd.concat([empty, *parts], ignore_index=True)


def run_category(run_ids: pd.Series) -> pd.CategoricalDtype:
    """Return the type of run ids in episodes."""
    return pd.CategoricalDtype(pd.Index(run_ids.to_list(), dtype="str"))


def _read_files(
    store: Store,
    runs: pd.DataFrame,
    name: str,
    parse: Callable[[bytes], Any],
    problems: list[str],
    *,
    optional: bool = False,
) -> dict[str, Any]:
    """Return the parsed artifact of each run that has it, by run id.

    `problems` gets a sentence for each damaged artifact and, unless `optional`, for each artifact
    that a finished run lacks.
    """

    def read(run: Mapping[Any, Any]) -> tuple[Any, str | None]:
        try:
            content = store.artifact(run["run_id"], run["artifact_uri"], name)
            if content is not None:
                return parse(content), None
        except Exception as error:
            return None, f"{name} can't be read: {reason_of_store_failure(error)}"
        if run["status"] == "done" and not optional:
            return None, f"{name} is missing in the store"
        return None, None

    records = runs.to_dict("records")
    parsed = {}
    # More threads cost CPU time where files are local.
    n_threads = 1 if database_file(store.uri) else DOWNLOADS_AT_ONCE
    with ThreadPoolExecutor(n_threads) as pool:
        for run, (value, problem) in zip(records, pool.map(read, records), strict=True):
            if value is not None:
                parsed[run["run_id"]] = value
            if problem:
                problems.append(
                    f"run {run['run_id']} ({run['cell']}, seed {run['seed']}): {problem}"
                )
    return parsed


def _duplicates(runs: pd.DataFrame) -> Iterator[str]:
    """Yield a sentence for each further run of a cell and seed, e.g. from another directory."""
    repeated = runs[runs.duplicated(["experiment", "cell", "seed"])]
    for run in repeated.to_dict("records"):
        seed_of_cell = f"{run['experiment']}, {run['cell']}, seed {run['seed']}"
        yield f"{seed_of_cell}: several runs have this cell and seed"

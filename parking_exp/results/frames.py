"""Load the results of runs from an MLflow store."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd

from parking_exp.config.credentials import keep_password
from parking_exp.config.paths import database, default_uri, directory_path
from parking_exp.errors import ParkingError, ResultsError, plural, suggestion
from parking_exp.evaluation.metrics import METRICS
from parking_exp.evaluation.trajectories import TRAJECTORIES_FILE
from parking_exp.results.dtypes import TEXT, column, integers, text, times, typed
from parking_exp.results.recordings import EPISODES, read_episodes, read_trajectories
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
CURVE = {f"eval/{metric.key}": metric.key for metric in METRICS if metric.in_curves}
BESIDE_A_CURVE = {"time/cpu_s": "cpu_s", "buffer/real_share": "real_share"}

RUN_COLUMNS = (
    "run_id", "name", "experiment", "cell", "run_key", "seed", "status", "error", *CONFIGURED.values(), "steps",
    *FINAL.values(), *COST.values(), "started", "ended", "run_dir", "artifact_uri", "git_commit", "git_dirty", "cpu",
)  # fmt: skip
"""Columns of `runs` before those of versions and config."""
CURVE_COLUMNS = ("run_id", "step", *CURVE.values(), *BESIDE_A_CURVE.values())
EPISODE_COLUMNS = ("run_id", *EPISODES)

DOWNLOADS_AT_ONCE = 16
SEED = re.compile(r"\d{1,18}")
OURS = ("cell", "seed", "run_key", "run_dir", "status")  # tags that make a run one of this package's


@dataclass(frozen=True, eq=False)
class Results:
    """What a store knows of some experiments.

    Attributes:
        runs, curves, episodes: the frames that `help(parking_exp.results)` describes.
        uri: the store.
        problems: a sentence for each thing that is missing or broken; the frames have the rest.
        ignored: how many runs were left out, as they are none of this package's.
        store: a connection to it, for recordings; None: there are none.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    episodes: pd.DataFrame
    uri: str
    problems: tuple[str, ...] = ()
    ignored: int = 0
    store: Store | None = None

    def __repr__(self) -> str:
        sizes = ", ".join(f"{len(getattr(self, name))} {name}" for name in ("runs", "curves", "episodes"))
        return f"<Results of {self.uri}: rows of {sizes}; {len(self.problems)} problems>"

    def trajectories(self, run_id: str) -> pd.DataFrame:
        """Return the car's trajectories in final episodes of a run: one row per step, the start (step 0) included.

        Columns are scene, step (int64), x_m, y_m, heading_rad, speed_mps (float32). A run without a recording has none.

        Raises:
            ResultsError: there is no such run, or its recording can't be read.
        """
        self._refuse_unknown(run_id)
        places = self.runs.loc[self.runs["run_id"] == run_id, "artifact_uri"]
        with _refused(f"run {run_id}: {TRAJECTORIES_FILE} can't be read"):
            stored = self.store.artifact(run_id, places.iloc[0], TRAJECTORIES_FILE) if self.store else None
            return read_trajectories(stored)

    def _refuse_unknown(self, run_id: str) -> None:
        if run_id not in set(self.runs["run_id"]):
            hint = suggestion(run_id, self.runs["run_id"])
            raise ResultsError(f"run_id={run_id}: it is none of {plural(len(self.runs), 'run')}{hint}")


def load(
    experiments: str | Iterable[str] | None = None, *, uri: str | None = None, output_dir: str | Path = "outputs"
) -> Results:
    """Read runs from a store.

    Args:
        experiments: name of one, or names; None for all.
        uri: any MLflow tracking URI; None for the embedded store of `output_dir`.
        output_dir: where runs are.

    Raises:
        ResultsError: there is no such store, it can't be read, there is no such experiment, or it has no runs.
    """
    here = directory_path(output_dir)
    return read_store(Store(keep_password(uri), None) if uri else Store(default_uri(here), here), experiments)


def read_store(store: Store, experiments: str | Iterable[str] | None) -> Results:
    """Read runs from a store that may have been asked for them already; see `load`.

    Raises:
        ResultsError: as `load`.
    """
    if (path := database(store.uri)) is not None and not path.is_file():
        raise ResultsError(f"there is no store {path}; train something first, or name another output_dir or store")
    with _refused(f"the store {store.uri} can't be read"):
        ids = _chosen(store, experiments)
        stored = [run for run in store.runs(list(ids.values())) if run.info.lifecycle_stage == "active"]
    kept = [run for run in stored if _is_ours(run)]
    if not kept:
        asked = store.uri if experiments is None else f"experiment={','.join(ids)}"
        raise ResultsError(
            f"{asked}: it has no runs of parking_exp{f', but {len(stored)} by others' if stored else ''}"
        )
    runs = _runs(kept, {experiment_id: name for name, experiment_id in ids.items()}, store.run_dir)
    logs, log_problems = _contents(store, runs, "metrics.jsonl")
    points, damaged = _points(logs)
    runs["steps"] = runs["run_id"].map(points.groupby("run_id")["step"].max()).fillna(0).astype("int64")
    over = runs[runs["status"] != "running"]
    tables, table_problems = _contents(store, over, "episodes.csv")
    episodes, unread = read_episodes(tables, runs["run_id"].to_list())
    table_problems |= {run_id: f"episodes.csv can't be read: {what}" for run_id, what in unread.items()}
    problems = (*_twice(runs), *_sentences(runs, log_problems | damaged), *_sentences(runs, table_problems))
    return Results(runs, _curves(points), episodes, store.uri, problems, len(stored) - len(kept), store)


@contextmanager
def _refused(what: str) -> Iterator[None]:
    """Turn any error of a store or its files into a sentence.

    Raises:
        ResultsError: what can't be read, and why.
    """
    try:
        yield
    except ParkingError:
        raise
    except Exception as error:
        raise ResultsError(f"{what}: {reason(error)}") from error


def _chosen(store: Store, experiments: str | Iterable[str] | None) -> dict[str, str]:
    """Return the ids of the experiments that are meant, by name."""
    known = store.experiments()
    if experiments is None:
        return known
    names = [experiments] if isinstance(experiments, str) else list(experiments)
    for name in names:
        if name not in known:
            hint = suggestion(name, set(known) - {"Default"})
            raise ResultsError(f"experiment={name}: {store.uri} has none of that name{hint}")
    return {name: known[name] for name in names}


def _is_ours(run: "Run") -> bool:
    tags = run.data.tags
    return all(name in tags for name in OURS) and tags["status"] in STATUSES and bool(SEED.fullmatch(tags["seed"]))


def _runs(stored: Sequence["Run"], names: Mapping[str, str], run_dir: Callable[["Run"], Path | None]) -> pd.DataFrame:
    infos = [run.info for run in stored]
    tags, params, metrics = ([getattr(run.data, what) for run in stored] for what in ("tags", "params", "metrics"))
    done = np.array([tag["status"] == "done" for tag in tags])

    def numbers(key: str) -> np.ndarray:
        return np.array([values.get(key, np.nan) for values in metrics], dtype="float64")

    def tagged(name: str) -> Any:
        return text(tag.get(name) for tag in tags)

    versions = sorted({name for tag in tags for name in tag if name.startswith("version.")})
    keys = sorted({key for param in params for key in param})
    columns = {
        "run_id": text(info.run_id for info in infos),
        "name": text(info.run_name for info in infos),
        "experiment": text(names[info.experiment_id] for info in infos),
        "cell": tagged("cell"),
        "run_key": tagged("run_key"),
        "seed": np.array([int(tag["seed"]) for tag in tags], dtype="int64"),
        "status": pd.Categorical([tag["status"] for tag in tags], STATUSES),
        "error": text(tag.get("error") or None for tag in tags),
        **{name: integers(param.get(key) for param in params) for key, name in CONFIGURED.items()},
        "steps": np.zeros(len(stored), dtype="int64"),
        **{name: np.where(done, numbers(key), np.nan) for key, name in FINAL.items()},
        **{name: numbers(key) for key, name in COST.items()},
        "started": times(info.start_time for info in infos),
        "ended": times(info.end_time for info in infos),
        "run_dir": text(str(place) if (place := run_dir(run)) else None for run in stored),
        "artifact_uri": text(info.artifact_uri for info in infos),
        "git_commit": tagged("git_commit"),
        "git_dirty": tagged("git_dirty").map({"true": True, "false": False}).astype("boolean"),
        "cpu": tagged("cpu"),
        **{name: tagged(name) for name in versions},
        **{f"config.{key}": column([typed(param.get(key)) for param in params]) for key in keys},
    }
    return pd.DataFrame(columns).sort_values(["experiment", "cell", "seed", "started"], ignore_index=True)


def _contents(store: Store, runs: pd.DataFrame, name: str) -> tuple[dict[str, bytes], dict[str, str]]:
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


def _points(logs: Mapping[str, bytes]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return the metrics of curves as one row per point, and what is wrong with logs, by run id."""
    names = {**CURVE, **BESIDE_A_CURVE}
    rows, damaged = [], {}
    for run_id, content in logs.items():
        try:
            for record in map(json.loads, content.splitlines()):
                known = [(names[key], value) for key, value in record["metrics"].items() if key in names]
                rows += [(name, run_id, np.int64(record["step"]), float(value)) for name, value in known]
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            damaged[run_id] = "metrics.jsonl can't be read: it is damaged"
    return pd.DataFrame(rows, columns=["name", "run_id", "step", "value"]).astype(
        {"name": TEXT, "run_id": TEXT, "step": "int64", "value": "float64"}
    ), damaged


def _curves(points: pd.DataFrame) -> pd.DataFrame:
    evaluated = points.loc[points["name"].isin(list(CURVE.values())), ["run_id", "step"]].drop_duplicates()
    # A step that was logged twice counts as it was logged last.
    wide = points.drop_duplicates(["run_id", "step", "name"], keep="last").pivot(
        index=["run_id", "step"], columns="name", values="value"
    )
    wide = wide.reindex(columns=[*CURVE.values(), *BESIDE_A_CURVE.values()]).rename_axis(columns=None).reset_index()
    return wide.merge(evaluated, on=["run_id", "step"]).sort_values(["run_id", "step"], ignore_index=True)


def _sentences(runs: pd.DataFrame, problems: Mapping[str, str]) -> Iterator[str]:
    for run_id, cell, seed in zip(runs["run_id"], runs["cell"], runs["seed"], strict=True):
        if run_id in problems:
            yield f"run {run_id} ({cell}, seed {seed}): {problems[run_id]}"


def _twice(runs: pd.DataFrame) -> Iterator[str]:
    """Yield a sentence for each run that is there more than once, e.g. from two output directories with one store."""
    ids = runs.groupby(["experiment", "cell", "seed"], sort=False)["run_id"].agg(list)
    for key, run_ids in ids[ids.map(len) > 1].items():
        experiment, cell, seed = cast(tuple[str, str, int], key)
        yield f"{experiment}, {cell}, seed {seed}: {len(run_ids)} runs have it"

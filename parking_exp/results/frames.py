"""Load the results of runs from an MLflow store."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd

from parking_exp.config.credentials import keep_password
from parking_exp.config.paths import default_uri, directory_path
from parking_exp.errors import ResultsError, plural, suggestion
from parking_exp.evaluation.metrics import METRICS
from parking_exp.evaluation.trajectories import TRAJECTORIES_FILE
from parking_exp.results.dtypes import TEXT, column, flags, integers, text, times, typed
from parking_exp.results.recordings import EPISODES, read_episodes, read_trajectories
from parking_exp.tracking.failures import is_store_failure, reason
from parking_exp.tracking.reader import Reader

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
        artifacts_in: the folder that artifacts have to lie in; None: anywhere.
    """

    runs: pd.DataFrame
    curves: pd.DataFrame
    episodes: pd.DataFrame
    uri: str
    problems: tuple[str, ...] = ()
    ignored: int = 0
    artifacts_in: Path | None = None

    def __repr__(self) -> str:
        sizes = ", ".join(f"{len(getattr(self, name))} {name}" for name in ("runs", "curves", "episodes"))
        return f"<Results of {self.uri}: rows of {sizes}; {len(self.problems)} problems>"

    @cached_property
    def _reader(self) -> Reader:
        return Reader(self.uri, self.artifacts_in)

    def trajectories(self, run_id: str) -> pd.DataFrame:
        """Return the car's trajectories in final episodes of a run: one row per step, the start (step 0) included.

        Columns are scene, step (int64), x_m, y_m, heading_rad, speed_mps (float32). A run without a recording has none.

        Raises:
            ResultsError: there is no such run, or its recording can't be read.
        """
        self._refuse_unknown(run_id)
        places = self.runs.loc[self.runs["run_id"] == run_id, "artifact_uri"]
        try:
            return read_trajectories(self._reader.artifact(run_id, places.iloc[0], TRAJECTORIES_FILE))
        except Exception as error:
            if not isinstance(error, ValueError) and not is_store_failure(error):  # a damaged file is a ValueError
                raise
            raise ResultsError(f"run {run_id}: {TRAJECTORIES_FILE} can't be read: {reason(error)}") from error

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
    reader = Reader(keep_password(uri)) if uri else Reader(default_uri(here), artifacts_in=here)
    ids = _chosen(reader, experiments)
    found = reader.runs(list(ids.values()))
    kept = [run for run in found if _is_ours(run)]
    if not kept:
        asked = reader.uri if experiments is None else f"experiment={','.join(ids)}"
        raise ResultsError(f"{asked}: it has no runs of parking_exp{f', but {len(found)} by others' if found else ''}")
    runs = _runs(kept, {experiment_id: name for name, experiment_id in ids.items()}, reader.run_dir)
    logs, missing = _contents(reader, runs, "metrics.jsonl")
    points, damaged = _points(logs)
    runs["steps"] = runs["run_id"].map(points.groupby("run_id")["step"].max()).fillna(0).astype("int64")
    episodes, problems = _episodes(reader, runs[runs["status"] != "running"], runs["run_id"].to_list())
    said = (*_twice(runs), *_sentences(runs, {**missing, **damaged}), *problems)
    return Results(runs, _curves(points), episodes, reader.uri, said, len(found) - len(kept), None if uri else here)


def _chosen(reader: Reader, experiments: str | Iterable[str] | None) -> dict[str, str]:
    """Return the ids of the experiments that are meant, by name."""
    there = reader.experiments()
    if experiments is None:
        return there
    asked = [experiments] if isinstance(experiments, str) else list(experiments)
    for name in asked:
        if name not in there:
            hint = suggestion(name, set(there) - {"Default"})
            raise ResultsError(f"experiment={name}: {reader.uri} has none of that name{hint}")
    return {name: there[name] for name in asked}


def _is_ours(run: "Run") -> bool:
    tags = run.data.tags
    return all(name in tags for name in OURS) and tags["status"] in STATUSES and bool(SEED.fullmatch(tags["seed"]))


def _runs(
    found: Sequence["Run"], names: Mapping[str, str], located: Callable[[str | None], str | None]
) -> pd.DataFrame:
    tags, params, metrics = ([getattr(run.data, what) for run in found] for what in ("tags", "params", "metrics"))
    infos = [run.info for run in found]
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
        "steps": np.zeros(len(found), dtype="int64"),
        **{name: np.where(done, numbers(key), np.nan) for key, name in FINAL.items()},
        **{name: numbers(key) for key, name in COST.items()},
        "started": times(info.start_time for info in infos),
        "ended": times(info.end_time for info in infos),
        "run_dir": text(located(tag.get("run_dir")) for tag in tags),
        "artifact_uri": text(info.artifact_uri for info in infos),
        "git_commit": tagged("git_commit"),
        "git_dirty": flags(tag.get("git_dirty") for tag in tags),
        "cpu": tagged("cpu"),
        **{name: tagged(name) for name in versions},
        **{f"config.{key}": column([typed(param.get(key)) for param in params]) for key in keys},
    }
    return pd.DataFrame(columns).sort_values(["experiment", "cell", "seed", "started"], ignore_index=True)


def _contents(reader: Reader, runs: pd.DataFrame, name: str) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return an artifact of each run that has it, and what is wrong with the others', by run id."""
    contents, problems = {}, {}
    places = list(zip(runs["run_id"], runs["artifact_uri"], strict=True))
    for (run_id, _), status, content in zip(places, runs["status"], reader.artifacts(places, name), strict=True):
        if isinstance(content, Exception):
            problems[run_id] = f"{name} can't be read: {reason(content)}"
        elif content is not None:
            contents[run_id] = content
        elif status == "done":  # others may not have come to an evaluation
            problems[run_id] = f"{name} is missing in the store"
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


def _episodes(reader: Reader, over: pd.DataFrame, run_ids: Sequence[str]) -> tuple[pd.DataFrame, Iterable[str]]:
    """Return the episodes of runs that are over, and what is wrong with some runs' tables."""
    texts, problems = _contents(reader, over, "episodes.csv")
    episodes, broken = read_episodes(texts, run_ids)
    problems |= {run_id: f"episodes.csv can't be read: {what}" for run_id, what in broken.items()}
    return episodes, _sentences(over, problems)


def _sentences(runs: pd.DataFrame, problems: Mapping[str, str]) -> Iterator[str]:
    for run_id, cell, seed in zip(runs["run_id"], runs["cell"], runs["seed"], strict=True):
        if run_id in problems:
            yield f"run {run_id} ({cell}, seed {seed}): {problems[run_id]}"


def _twice(runs: pd.DataFrame) -> Iterator[str]:
    """Say which runs are there more than once, e.g. from two output directories that share a store."""
    found = runs.groupby(["experiment", "cell", "seed"], sort=False)["run_id"].agg(list)
    for key, run_ids in found[found.map(len) > 1].items():
        experiment, cell, seed = cast(tuple[str, str, int], key)
        yield f"{experiment}, {cell}, seed {seed}: {len(run_ids)} runs have it"

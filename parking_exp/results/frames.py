"""Load the results of runs from an MLflow store."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd

from parking_exp.config.credentials import keep_password
from parking_exp.config.paths import default_uri, directory_path
from parking_exp.errors import ResultsError, first_few, plural, suggestion
from parking_exp.evaluation.metrics import METRICS, RUN_METRICS
from parking_exp.evaluation.trajectories import TRAJECTORIES_FILE
from parking_exp.results.dtypes import TEXT, column, flags, integers, text, times, typed
from parking_exp.results.invalid_values import sound_points, sound_runs
from parking_exp.results.recordings import EPISODES, read_episodes, read_trajectories
from parking_exp.tracking.failures import is_store_failure, reason
from parking_exp.tracking.reader import Point, Reader, StoredRun

STATUSES = ("done", "running", "failed", "interrupted", "pruned")
# Parameters and metrics, and their columns.
CONFIGURED = {
    "total_timesteps": "total_timesteps",
    "evaluation.final_n_scenes": "n_scenes",
    "evaluation.first_scene": "first_scene",
    "evaluation.n_scenes": "eval_n_scenes",
}
FINAL = {f"final/{metric.key}": metric.run_column for metric in METRICS}
COST = {metric.key: metric.name for metric in RUN_METRICS if metric.in_runs}
CURVE = {f"eval/{metric.key}": metric.key for metric in METRICS if metric.in_curves}
BESIDE_A_CURVE = {metric.key: metric.name for metric in RUN_METRICS if metric.in_curves}

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
            return read_trajectories(self._reader.artifact(places.iloc[0], TRAJECTORIES_FILE))
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
    sound, impossible = sound_runs(found)
    kept = [run for run in sound if _is_ours(run)]
    if not kept:
        asked = reader.uri if experiments is None else f"experiment={','.join(ids)}"
        raise ResultsError(f"{asked}: it has no runs of parking_exp{f', but {len(found)} by others' if found else ''}")
    histories, points = sound_points(reader.histories([run.run_id for run in kept], [*CURVE, *BESIDE_A_CURVE]))
    runs = _runs(kept, {experiment_id: name for name, experiment_id in ids.items()}, histories, reader.run_dir)
    curves = _curves(histories)
    episodes, problems = _episodes(reader, runs)
    wrong = {
        run_id: "impossible values count as missing: "
        + first_few([*impossible.get(run_id, []), *points.get(run_id, [])])
        for run_id in {*impossible, *points}
    }
    said = (*_twice(runs), *_sentences(runs, wrong), *problems)
    return Results(runs, curves, episodes, reader.uri, said, len(found) - len(kept), None if uri else here)


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


def _is_ours(run: StoredRun) -> bool:
    tags = run.tags
    return all(name in tags for name in OURS) and tags["status"] in STATUSES and bool(SEED.fullmatch(tags["seed"]))


def _runs(
    found: Sequence[StoredRun],
    names: Mapping[str, str],
    histories: Mapping[str, list[Point]],
    located: Callable[[str | None], str | None],
) -> pd.DataFrame:
    steps: dict[str, int] = {}
    for points in histories.values():
        for run_id, step, _, _ in points:
            steps[run_id] = max(step, steps.get(run_id, 0))
    tags, params, metrics = ([getattr(run, what) for run in found] for what in ("tags", "params", "metrics"))
    done = np.array([tag["status"] == "done" for tag in tags])

    def numbers(key: str) -> np.ndarray:
        return np.array([values.get(key, np.nan) for values in metrics], dtype="float64")

    def tagged(name: str) -> Any:
        return text(tag.get(name) for tag in tags)

    versions = sorted({name for tag in tags for name in tag if name.startswith("version.")})
    keys = sorted({key for param in params for key in param})
    columns = {
        "run_id": text(run.run_id for run in found),
        "name": text(run.name for run in found),
        "experiment": text(names[run.experiment_id] for run in found),
        "cell": tagged("cell"),
        "run_key": tagged("run_key"),
        "seed": np.array([int(tag["seed"]) for tag in tags], dtype="int64"),
        "status": pd.Categorical([tag["status"] for tag in tags], STATUSES),
        "error": text(tag.get("error") or None for tag in tags),
        **{name: integers(param.get(key) for param in params) for key, name in CONFIGURED.items()},
        "steps": np.array([steps.get(run.run_id, 0) for run in found], dtype="int64"),
        **{name: np.where(done, numbers(key), np.nan) for key, name in FINAL.items()},
        **{name: numbers(key) for key, name in COST.items()},
        "started": times(run.start_ms for run in found),
        "ended": times(run.end_ms for run in found),
        "run_dir": text(located(tag.get("run_dir")) for tag in tags),
        "artifact_uri": text(run.artifact_uri for run in found),
        "git_commit": tagged("git_commit"),
        "git_dirty": flags(tag.get("git_dirty") for tag in tags),
        "cpu": tagged("cpu"),
        **{name: tagged(name) for name in versions},
        **{f"config.{key}": column([typed(param.get(key)) for param in params]) for key in keys},
    }
    return pd.DataFrame(columns).sort_values(["experiment", "cell", "seed", "started"], ignore_index=True)


def _curves(histories: Mapping[str, list[Point]]) -> pd.DataFrame:
    names = {**CURVE, **BESIDE_A_CURVE}
    points = [(names[key], *point) for key, found in histories.items() for point in found]
    table = pd.DataFrame(points, columns=["name", "run_id", "step", "time_ms", "value"])
    table = table.astype({"name": TEXT, "run_id": TEXT, "step": "int64", "value": "float64"})
    # A step that was logged twice counts as it was logged last.
    table = table.sort_values("time_ms", kind="stable").drop_duplicates(["run_id", "step", "name"], keep="last")
    evaluated = table.loc[table["name"].isin(list(CURVE.values())), ["run_id", "step"]].drop_duplicates()
    wide = table.pivot(index=["run_id", "step"], columns="name", values="value")
    wide = wide.reindex(columns=list(names.values())).rename_axis(columns=None).reset_index()
    return wide.merge(evaluated, on=["run_id", "step"]).sort_values(["run_id", "step"], ignore_index=True)


def _episodes(reader: Reader, runs: pd.DataFrame) -> tuple[pd.DataFrame, Iterable[str]]:
    """Return all episodes, and what is wrong with some runs' tables. Running ones send theirs when they are over."""
    over = runs[runs["status"] != "running"]
    texts, problems = {}, {}
    contents = reader.artifacts(over["artifact_uri"], "episodes.csv")
    for run_id, status, content in zip(over["run_id"], over["status"], contents, strict=True):
        if isinstance(content, Exception):
            problems[run_id] = f"can't be read: {reason(content)}"
        elif content is not None:
            texts[run_id] = content
        elif status == "done":  # others may not have come to an evaluation
            problems[run_id] = "is missing in the store"
    episodes, broken = read_episodes(texts, runs["run_id"].to_list())
    problems |= {run_id: f"can't be read: {what}" for run_id, what in broken.items()}
    return episodes, _sentences(runs, {run_id: f"episodes.csv {what}" for run_id, what in problems.items()})


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

"""Stores with made-up runs, for tests of what reads a store.

Configs are really composed, run directories have the files that a training leaves, and the store
gets them by `sync_run`.
"""

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from parking_exp.config.paths import default_uri
from parking_exp.config.schema import RunConfig
from parking_exp.evaluation.evaluate_policy import summarise
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import sha256
from parking_exp.runs.metric_logs import append_episodes, copy_logs
from parking_exp.runs.run_provenance import provenance_tags
from parking_exp.tasks.metrics import episode_columns
from parking_exp.tasks.parking.parking_metrics import METRICS
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import sync_run
from support.result_frames import Run, outcomes
from support.runs import smoke_config

STARTED_MS = 1_700_000_000_000
WALL_S = 600.0


@dataclass(frozen=True)
class Look(Run):
    """What a made-up run looks like in its run directory and in the store.

    Attributes:
        curve: success rate of each evaluation, evenly spaced; None: a rise to `success` in
            every_n_steps.
        steps: mean length of its episodes.
        progress: fraction of the evaluations that an unfinished run has made.
        missing, contents: artifacts that are missing, and those with other content.
        nan: metrics that are not a number.
        tags: that the store has besides or instead; None: a missing tag.
        settings: that its config.yaml has besides, under the key `x`.
    """

    crash: float = 0.1
    curve: Sequence[float] | None = None
    steps: float = 40.0
    progress: float = 0.5
    missing: Sequence[str] = ()
    contents: Mapping[str, bytes] = field(default_factory=dict)
    nan: Sequence[str] = ()
    tags: Mapping[str, str | None] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    started_ms: int = STARTED_MS


def make_store(
    output_dir,
    experiment,
    cells,
    seeds=range(2),
    look_of=lambda label, seed: Look(),
    *,
    uri=None,
):
    """Make the runs of an experiment, and the store that has them; return the run directories by
    label and seed.

    Args:
        output_dir: where run directories go.
        experiment: name.
        cells: overrides of `experiment=smoke` for each, or its config.
        seeds: of each cell.
        look_of: the look of a run, from its cell's label and seed.
        uri: of the store; None: `mlflow.db` in the output directory.
    """
    where = uri or default_uri(Path(output_dir).absolute())
    runs = {}
    for label, cell in cells.items():
        whole = cell if isinstance(cell, RunConfig) else smoke_config(*cell)
        tracking = whole.tracking.model_copy(update={"uri": uri})
        for seed in seeds:
            update = {
                "experiment_name": experiment,
                "output_dir": str(output_dir),
                "seed": seed,
                "tracking": tracking,
            }
            config = whole.model_copy(update=update)
            runs[label, seed] = RunDirectory(config.run_dir)
            _write(runs[label, seed], config, look_of(label, seed), label, where)
    store = Store(where, Path(output_dir).absolute())
    for key, directory in runs.items():
        _send(directory, look_of(*key), store)
    return runs


def made_episodes(look, success, scenes, seed):
    """Return a table of episodes in which rates are as asked for; which scenes fail depends on the
    seed.
    """
    n = len(scenes)
    rng = np.random.default_rng([seed, n])
    outcome = np.array(outcomes(success, look.crash, n))
    parked = np.arange(n) < min(round(look.parked * n), round(success * n))
    order = rng.permutation(n)
    table = pd.DataFrame(
        {
            "scene": list(scenes),
            "outcome": outcome[order],
            "parked": parked[order],
            "steps": np.maximum(1, np.round(look.steps + rng.integers(-5, 6, n))).astype(int),
            "gear_changes": order % 3,
        }
    )
    for name in episode_columns(METRICS):
        if name not in table:
            table[name] = rng.uniform(0, 1, n)
    return table


def _evaluated(config, look):
    """Return (step, success rate) of the evaluations that a run has made."""
    total = config.total_timesteps
    rates = look.curve
    if rates is None:
        n_evaluations = max(1, total // (config.evaluation.every_n_steps or total))
        rates = np.linspace(0, look.success, n_evaluations + 1)[1:].tolist()
    points = [(round(total * (k + 1) / len(rates)), rate) for k, rate in enumerate(rates)]
    return points if look.status == "done" else points[: math.floor(len(points) * look.progress)]


def _content(config, look):
    """Return the lines of metrics, and (phase, step, episodes) of all evaluations."""
    evaluation = config.evaluation
    final_scenes = range(evaluation.first_scene, evaluation.first_scene + evaluation.final_n_scenes)
    scenes = final_scenes[: evaluation.n_scenes]
    rows = []
    tables = []
    for step, rate in _evaluated(config, look):
        table = made_episodes(look, rate, scenes, config.seed + step)
        tables.append(("eval", step, table))
        share = step / config.total_timesteps
        cost = {
            "time/cpu_s": look.cpu_s * share,
            "time/wall_s": WALL_S * share,
            "buffer/real_share": 0.5,
        }
        rows.append((step, {**_summary("eval", table), **cost, "train/actor_loss": 0.5}))
    if look.status == "done":
        final = made_episodes(look, look.success, final_scenes, config.seed)
        certified = final.head(evaluation.n_certified_scenes)
        for phase, table in (("final", final), ("certified", certified)):
            tables.append((phase, step, table))
            rows[-1][1].update(_summary(phase, table))
    lines = []
    for step, values in rows:
        metrics = {key: float(value) for key, value in values.items()}
        metrics |= {key: math.nan for key in look.nan if key in metrics}
        lines.append({"step": step, "time_ms": look.started_ms + step, "metrics": metrics})
    return lines, tables


def _summary(phase, table):
    return {f"{phase}/{name}": value for name, value in summarise(table, METRICS).items()}


@cache
def _provenance():
    return provenance_tags()  # it asks git


def _write(directory, config, look, label, uri):
    """Write a run directory."""
    path = directory.path
    lines, tables = _content(config, look)
    directory.write_config(config)
    directory.models.mkdir(exist_ok=True)
    write_json(path / "provenance.json", {"started_ms": look.started_ms, "tags": _provenance()})
    (path / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for phase, step, table in tables:
        append_episodes(path / "episodes.csv", table, phase, step)
    for name, content in look.contents.items():
        (path / name).write_bytes(content)
    for name in look.missing:
        (path / name).unlink(missing_ok=True)
    entries = {"label": label, "total_timesteps": config.total_timesteps, "tracking_uri": uri}
    if look.status == "done":
        latest = {key: value for line in lines for key, value in line["metrics"].items()}
        directory.finish(config.total_timesteps, latest, **entries)
        return
    directory.update_status(status=look.status, error=look.error, **entries)
    if lines:  # a checkpoint, without which the store gets no metrics yet
        folder = directory.checkpoints / f"step={lines[-1]['step']:010d}"
        folder.mkdir(parents=True)
        copy_logs(path, folder)
        write_json(folder / "manifest.json", {"metrics.jsonl": sha256(folder / "metrics.jsonl")})
    if look.status == "failed":
        (path / "traceback.txt").write_text(f"Traceback (most recent call last):\n{look.error}\n")


def _send(directory, look, store):
    """Send a run directory to the store, then give it there what a training would not."""
    with directory.training_lock() if look.status == "running" else nullcontext():
        sync_run(directory, store)
    assert directory.run_id is not None
    for key, value in look.tags.items():
        if value is None:
            store.client.delete_tag(directory.run_id, key)
        else:
            store.client.set_tag(directory.run_id, key, value)
    if look.settings:
        run = store.client.get_run(directory.run_id)
        config = store.artifact(directory.run_id, run.info.artifact_uri, "config.yaml")
        store.put_artifact(
            run, "config.yaml", config + yaml.safe_dump({"x": dict(look.settings)}).encode()
        )

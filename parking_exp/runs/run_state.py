"""The state of runs (done, running, failed, pending, pruned), read from the small files of their directories."""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from parking_exp.config.cell_labels import label_cells, settings_of
from parking_exp.runs.atomic_files import fingerprint, read_plain_yaml
from parking_exp.runs.directory import HEARTBEAT_FILE, STATUS_FILE, RunDirectory
from parking_exp.runs.status_schema import HeartbeatEntries, StatusEntries, read_entries
from parking_exp.runs.stored_config import CONFIG_FILE

Stage = Literal["done", "running", "failed", "pending", "pruned"]
STAGES: tuple[Stage, ...] = ("done", "running", "failed", "pending", "pruned")


@dataclass(frozen=True)
class RunState:
    """One run, as it is now.

    Attributes:
        run_dir: absolute run directory.
        experiment, cell, seed: what it belongs to.
        label: what sets its cell apart from the others of its sweep, or from all of its experiment (`labelled`); before
            its first plan, the cell's name.
        trial: number of the trial of a search that it is part of.
        stage: done, running (a process holds one of its locks), failed, pending, also after it was cut off, or
            pruned by a search.
        step, total_timesteps: env steps done (pending: saved), and in all.
        steps_per_s: while training.
        left_s: until the training is over, at that rate.
        doing: what a running one is at, e.g. `train`, `certification on highway-env`.
        host, pid: where it runs, or ran last.
        reason: why it failed.
        killed: it failed because its process was killed or lost, which says nothing about the run itself.
        success_rate, wall_s, cpu_s, memory_bytes: of a finished run.
        started: when its last process began, in seconds since 1970.
        unsynced: why the store does not have all of it; None where it has.
        damaged: what is wrong with its status.json; None if nothing is.
    """

    run_dir: str
    experiment: str
    cell: str
    seed: int
    label: str
    stage: Stage
    step: int
    total_timesteps: int | None
    steps_per_s: float | None = None
    left_s: float | None = None
    doing: str | None = None
    host: str | None = None
    pid: int | None = None
    reason: str | None = None
    killed: bool = False
    success_rate: float | None = None
    wall_s: float | None = None
    cpu_s: float | None = None
    memory_bytes: int | None = None
    unsynced: str | None = None
    started: float | None = None
    damaged: str | None = None
    trial: int | None = None

    def plain(self) -> dict[str, Any]:
        """Return everything as JSON can hold it."""
        return asdict(self)


def read_state(path: Path) -> RunState:
    """Read one run directory; one that is not there yet is pending, and so is one whose status.json can't be read."""
    status, damaged = read_entries(path / STATUS_FILE, StatusEntries)
    seed = path.name.removeprefix("seed=")
    known: dict[str, Any] = {
        "run_dir": str(path),
        "experiment": path.parent.parent.name,
        "cell": path.parent.name,
        "seed": int(seed) if seed.isdecimal() else -1,
        "label": status.get("label") or path.parent.name,
        "total_timesteps": status.get("total_timesteps"),
        "unsynced": status.get("unsynced"),
        "started": status.get("started"),
        "damaged": damaged,
        "trial": status.get("trial"),
    }
    written = status.get("status", "pending")
    if written == "done":
        cost = {name: status.get(name) for name in ("success_rate", "wall_s", "cpu_s", "memory_bytes", "host")}
        return RunState(**known, stage="done", step=status.get("steps", 0), **cost)  # type: ignore[arg-type]
    where: dict[str, Any] = {"host": status.get("host"), "pid": status.get("pid")}
    if RunDirectory(path).under_way:
        return RunState(**known, stage="running", **where, **_under_way(path, known["total_timesteps"], status))
    if written == "failed":
        killed = bool(status.get("killed"))
        reason = status.get("error")
        return RunState(**known, stage="failed", step=_saved_step(path), **where, reason=reason, killed=killed)
    stage: Stage = "pruned" if written == "pruned" else "pending"
    return RunState(**known, stage=stage, step=_saved_step(path))


def labelled(states: Sequence[RunState]) -> list[RunState]:
    """Label runs by what sets the config of their cell apart from the others of its experiment, as reports do.

    Runs of a search keep the label of their trial, and so do runs whose config can't be read.
    """
    configs: dict[tuple[str, str], Any] = {}
    for key, runs in by_cell(states):
        with suppress(OSError, ValueError):
            path = Path(runs[0].run_dir) / CONFIG_FILE
            found = _read_config(path, *fingerprint(path))
            if isinstance(found, dict) and runs[0].trial is None:
                configs[key] = settings_of(found)
    labels: dict[tuple[str, str], str] = {}
    for experiment in {experiment for experiment, _ in configs}:
        own = [key for key in configs if key[0] == experiment]
        labels |= zip(own, label_cells([configs[key] for key in own], [cell for _, cell in own]), strict=True)
    return [replace(state, label=labels.get((state.experiment, state.cell), state.label)) for state in states]


@cache
def _read_config(path: Path, size: int, time_ns: int) -> Any:
    """Read a config once while it stays as it is: `status.py watch=true` asks for it every other second."""
    return read_plain_yaml(path)


def counts(states: Iterable[RunState]) -> dict[Stage, int]:
    """Return how many runs are at which stage."""
    found = [state.stage for state in states]
    return {stage: found.count(stage) for stage in STAGES}


def by_cell(states: Iterable[RunState]) -> Iterator[tuple[tuple[str, str], list[RunState]]]:
    """Yield ((experiment, cell), its runs), in the order of their first runs."""
    cells: dict[tuple[str, str], list[RunState]] = {}
    for state in states:
        cells.setdefault((state.experiment, state.cell), []).append(state)
    yield from cells.items()


def _under_way(path: Path, total: int | None, status: dict[str, Any]) -> dict[str, Any]:
    heartbeat, _ = read_entries(path / HEARTBEAT_FILE, HeartbeatEntries)
    if heartbeat.get("time", 0.0) < status.get("started", time.time()):  # of an earlier process, or none yet
        return {"step": _saved_step(path), "doing": "starting"}
    step, rate = heartbeat.get("step", 0), heartbeat.get("steps_per_s") or None
    left = (total - step) / rate if rate and total is not None else None
    return {"step": step, "steps_per_s": rate, "left_s": left, "doing": heartbeat.get("doing")}


def _saved_step(path: Path) -> int:
    """Env step of the newest checkpoint; 0 without one."""
    names = [folder.name.removeprefix("step=") for folder in (path / "checkpoints").glob("step=*")]
    return max((int(name) for name in names if name.isdecimal()), default=0)


def as_plain(states: Sequence[RunState]) -> dict[str, Any]:
    """Return runs as JSON can hold them: how many are at which stage, in all and in each cell, and each run."""
    cells = [
        {
            "experiment": experiment,
            "cell": cell,
            "label": runs[0].label,
            **counts(runs),
            "runs": [r.plain() for r in runs],
        }
        for (experiment, cell), runs in by_cell(states)
    ]
    found: dict[str, Any] = dict(counts(states).items())
    return found | {"cells": cells}

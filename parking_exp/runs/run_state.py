"""The state of runs, read from their directories.

A run's `status` is what its status.json says. Its `stage` is what is true now: a run that is
neither running, done nor failed is `pending`. Stores call it `interrupted`.
"""

import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

from parking_exp.runs.checkpoint_files import CHECKPOINTS, saved_step
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import experiment_of
from parking_exp.runs.run_files import (
    HEARTBEAT_FILE,
    STATUS_FILE,
    HeartbeatEntries,
    StatusEntries,
    read_entries,
)

Stage = Literal["done", "running", "failed", "pending"]
STAGES: tuple[Stage, ...] = get_args(Stage)
# How sentences describe runs that are not done.
STAGE_WORDS: Mapping[Stage, str] = {
    "running": "under way",
    "failed": "failed",
    "pending": "interrupted or not started",
}
NO_REASON = "no reason is known"
# Fields that `status.py` does not show.
NOT_SHOWN = (
    "status",
    "steps",
    "error",
    "run_id",
    "tracking_uri",
    "command",
    "search",
    "cell_number",
    "evaluation",
    "init_sha256",
)


class RunState(StatusEntries):
    """One run, as it is now: the entries of its status.json, and what other files and locks say."""

    run_dir: str  # absolute
    experiment: str
    cell: str  # its name
    seed: int
    label: str  # how its cell differs from the others of its sweep
    stage: Stage  # running: a process holds one of its locks; an interrupted one is pending
    step: int  # env steps done (pending: saved)
    killed: bool = False
    steps_per_s: float | None = None  # while training
    left_s: float | None = None  # until the training is over, at that rate
    doing: str | None = None  # what a running one does, e.g. `train`, `cross-check on highway-env`
    reason: str | None = None  # why it failed
    damaged: bool = False  # whether its status.json can't be read

    def plain(self) -> dict[str, Any]:
        """Return the entries that `status.py` shows, as JSON values."""
        return self.model_dump(exclude={*NOT_SHOWN})


def read_state(path: Path) -> RunState:
    """Return the state of a run from its directory.

    Without a directory, or with a damaged status.json, it is pending.
    """
    stored = read_entries(path / STATUS_FILE, StatusEntries)
    entries = stored or StatusEntries()
    seed = path.name.removeprefix("seed=")
    fields: dict[str, Any] = {
        "label": path.parent.name,
        **entries.model_dump(exclude_none=True),
        "run_dir": str(path),
        "experiment": experiment_of(path),
        "cell": path.parent.name,
        "seed": int(seed) if seed.isdecimal() else -1,
        "stage": "pending",
        "damaged": stored is None,
    }
    if entries.status == "done":
        fields |= {"stage": "done", "step": entries.steps or 0}
    elif RunDirectory(path).is_locked:
        fields |= {"stage": "running", **_read_running(path, entries)}
    else:
        fields["step"] = saved_step(path / CHECKPOINTS)
        if entries.status == "failed":
            fields |= {"stage": "failed", "reason": entries.error}
    return RunState.model_construct(**fields)  # `read_entries` has checked what may be damaged


def in_plan_order(states: Iterable[RunState]) -> list[RunState]:
    """Sort runs by experiment and by the order of their plan, and make labels distinct.

    Cells of several plans may have the same label. The folder of the cell is then added to it.
    """
    in_order = sorted(states, key=_place)
    cells = {(state.experiment, state.label, state.cell) for state in in_order}
    n_cells = Counter((experiment, label) for experiment, label, _ in cells)

    labelled = []
    for state in in_order:
        label = state.label
        if n_cells[state.experiment, label] > 1:
            label = f"{label} ({state.cell})"
        labelled.append(state.model_copy(update={"label": label}))
    return labelled


def _place(state: RunState) -> tuple[str, int, str, int]:
    """Return the sort key of a run: its experiment, then the number of its trial or cell."""
    number = state.cell_number if state.trial is None else state.trial
    if number is None:  # it belongs to no plan
        number = sys.maxsize
    return state.experiment, number, state.cell, state.seed


def count_stages(states: Iterable[RunState]) -> dict[str, int]:
    """Return how many runs are at each stage."""
    stages = [state.stage for state in states]
    return {stage: stages.count(stage) for stage in STAGES}


def describe_unfinished(counts: Mapping[str, int]) -> list[str]:
    """Return how many runs are at each stage but `done`, e.g. `2 failed`; zeros are left out."""
    return [f"{counts[stage]} {words}" for stage, words in STAGE_WORDS.items() if counts[stage]]


def by_cell(states: Iterable[RunState]) -> dict[tuple[str, str], list[RunState]]:
    """Return the runs of each cell, by experiment and name of the cell, in the order of states."""
    cells: dict[tuple[str, str], list[RunState]] = {}
    for state in states:
        cells.setdefault((state.experiment, state.cell), []).append(state)
    return cells


def _read_running(path: Path, entries: StatusEntries) -> dict[str, Any]:
    """Return the fields of a running run from its heartbeat."""
    beat = read_entries(path / HEARTBEAT_FILE, HeartbeatEntries) or HeartbeatEntries()
    started = time.time() if entries.started is None else entries.started
    if beat.time < started:  # an earlier process wrote it, or there is none yet
        return {"step": saved_step(path / CHECKPOINTS), "doing": "starting"}
    left_s = None
    if beat.steps_per_s > 1e-3 and entries.total_timesteps is not None:
        left_s = (entries.total_timesteps - beat.step) / beat.steps_per_s
    return {
        "step": beat.step,
        "steps_per_s": beat.steps_per_s or None,
        "left_s": left_s,
        "doing": beat.doing,
    }


def as_plain(states: Sequence[RunState]) -> dict[str, Any]:
    """Return runs by cell as JSON can hold them, with how many are at each stage."""
    cells = []
    for (experiment, name), runs in by_cell(states).items():
        entry: dict[str, Any] = {"experiment": experiment, "cell": name, "label": runs[0].label}
        entry |= count_stages(runs)
        entry["runs"] = [run.plain() for run in runs]
        cells.append(entry)
    return {**count_stages(states), "cells": cells}

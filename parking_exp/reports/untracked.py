"""Runs in the output directory that the store does not have: those that have not begun, and those that failed at once.

They are the only thing that a report does not take from the store.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import pandas as pd

from parking_exp.config.schema import NAME
from parking_exp.reports.report_data import FailedRun
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.run_state import RunState, read_state

REASONS = {
    "running": "under way",
    "interrupted": "interrupted; rerun the sweep to resume it",
    "pending": "not begun",
    "done": "the store lacks it; python scripts/status.py sync=true sends it",
}


def run_paths(output_dir: Path, experiments: Iterable[str] | None) -> list[Path]:
    """Return the run directories of some experiments, None for all. In a store, they may be called anything."""
    if experiments is None:
        return find_runs(output_dir)
    return [path for name in experiments if re.fullmatch(NAME, name) for path in find_runs(output_dir, name)]


def find_untracked(runs: pd.DataFrame, output_dir: Path, experiments: Iterable[str]) -> list[RunState]:
    """Return the runs of some experiments in an output directory that are none of the runs of a store."""
    known = set(runs["run_dir"])
    return [read_state(path) for path in run_paths(output_dir, experiments) if str(path) not in known]


def with_untracked(runs: pd.DataFrame, untracked: Sequence[RunState]) -> tuple[pd.DataFrame, list[FailedRun]]:
    """Return runs of the store with the unfinished ones that it lacks of its cells, and all others that it lacks.

    Runs that a search has pruned are over, and no part of the others.
    """
    added, others = [], []
    for state in untracked:
        cell = runs[(runs["experiment"] == state.experiment) & (runs["cell"] == state.cell)]
        if len(cell) and state.stage != "done":
            added.append(_row(state, cell.iloc[:1]))
        elif state.stage != "pruned":
            reason = state.reason or REASONS.get(state.stage, "no reason is known")
            others.append(FailedRun(state.label, state.seed, state.stage, reason, state.run_dir))
    return pd.concat([runs, *added], ignore_index=True), others


def _row(state: RunState, like: pd.DataFrame) -> pd.DataFrame:
    """Return a row of `Results.runs` for a run that the store lacks, with the config of another run of its cell."""
    config = [str(column) for column in like if str(column).startswith("config.")]
    row = like[["experiment", "cell", "name", *config]].assign(
        run_id="", run_dir=state.run_dir, seed=state.seed, status=state.stage, error=state.reason, steps=0
    )
    return row.reindex(columns=like.columns).astype({**like.dtypes.to_dict(), "status": object})

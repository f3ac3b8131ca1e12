"""Collect the versions, commits, machines and settings of the runs of a report."""

from collections import Counter
from collections.abc import Iterator, Sequence

import pandas as pd

from parking_exp.config.settings import differing_keys, distinguishes_cells, with_defaults
from parking_exp.reports.cell_selection import CellRuns
from parking_exp.reports.report_data import Provenance, UnfinishedRun
from parking_exp.runs.run_state import NO_REASON, STAGE_WORDS

VERSION = "version."
SHORT_COMMIT = 10
REASONS = {
    "running": STAGE_WORDS["running"],
    "interrupted": f"{STAGE_WORDS['pending']}; rerun the sweep",
}


def collect_provenance(cells: Sequence[CellRuns], left_out: Sequence[str], uri: str) -> Provenance:
    """Return the provenance of cells; `left_out` are labels of their experiments' other cells."""
    runs = pd.concat([cell.runs for cell in cells])
    versions = {}
    for column in runs.filter(regex=r"^version\."):
        counts = _count_values(runs[column])
        if counts:
            versions[str(column).removeprefix(VERSION)] = counts
    dirty_marks = runs["git_dirty"].fillna(False).map({True: "+", False: ""})

    configs = [with_defaults(cell.config) for cell in cells]
    difference = {key: [config.get(key) for config in configs] for key in differing_keys(configs)}
    first_config = cells[0].config
    common = {}
    for key, value in first_config.items():
        if distinguishes_cells(key) and key not in difference:
            common[key] = value
    return Provenance(
        versions=versions,
        commits=_count_values(runs["git_commit"].str[:SHORT_COMMIT] + dirty_marks),
        machines=_count_values(runs["cpu"]),
        difference=difference,
        common=common,
        unfinished=list(_list_unfinished(cells)),
        uri=uri,
        left_out=left_out,
        first=_write_time(runs["started"].min()),
        last=_write_time(runs["ended"].max()),
    )


def _list_unfinished(cells: Sequence[CellRuns]) -> Iterator[UnfinishedRun]:
    for cell in cells:
        runs = cell.runs[~cell.runs["is_done"]].astype(object)
        for run in runs.where(runs.notna(), None).to_dict("records"):
            status = str(run["status"])
            reason = run["error"] or REASONS.get(status, NO_REASON)
            yield UnfinishedRun(cell.label, int(run["seed"]), status, reason, run["run_dir"])


def _write_time(time: pd.Timestamp) -> str | None:
    return None if pd.isna(time) else time.isoformat(timespec="seconds")


def _count_values(values: pd.Series) -> dict[str, int]:
    return {str(value): count for value, count in Counter(values.dropna()).most_common()}

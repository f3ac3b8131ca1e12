"""Provenance of a report: versions, commits, machines and configs of its runs, and runs without a result."""

from collections import Counter
from collections.abc import Sequence

import pandas as pd

from parking_exp.config.cell_labels import can_matter, differing
from parking_exp.reports.cell_selection import CellRuns
from parking_exp.reports.report_data import FailedRun, Provenance

VERSION = "version."
SHORT_COMMIT = 10
REASONS = {"running": "under way", "interrupted": "interrupted or not begun; rerun the sweep"}


def provenance(cells: Sequence[CellRuns], left_out: Sequence[str], uri: str) -> Provenance:
    """Return the provenance of the cells of a report; `left_out` are labels of the experiments' other cells."""
    runs = pd.concat([cell.runs for cell in cells])
    versions = {
        str(column).removeprefix(VERSION): _counts(runs[column]) for column in runs if str(column).startswith(VERSION)
    }
    marks = runs["git_dirty"].fillna(False).map({True: "+", False: ""})
    configs = [cell.config for cell in cells]
    difference = {key: [config.get(key) for config in configs] for key in differing(configs)}
    started, ended = runs["started"].dropna(), runs["ended"].dropna()
    return Provenance(
        versions={package: counts for package, counts in versions.items() if counts},
        commits=_counts(runs["git_commit"].str[:SHORT_COMMIT] + marks),
        machines=_counts(runs["cpu"]),
        difference=difference,
        common={key: value for key, value in configs[0].items() if key not in difference and can_matter(key)},
        unfinished=[run for cell in cells for run in _unfinished(cell)],
        uri=uri,
        left_out=list(left_out),
        first=started.min().isoformat(timespec="seconds") if len(started) else None,
        last=ended.max().isoformat(timespec="seconds") if len(ended) else None,
    )


def _unfinished(cell: CellRuns) -> list[FailedRun]:
    runs = cell.runs[~cell.runs["status"].isin(["done", "pruned"])]
    return [
        FailedRun(
            cell.label,
            int(run["seed"]),
            str(run["status"]),
            _text(run["error"]) or REASONS.get(str(run["status"]), "no reason is known"),
            _text(run["run_dir"]),
        )
        for run in runs.to_dict("records")
    ]


def _counts(values: pd.Series) -> dict[str, int]:
    return {str(value): count for value, count in Counter(values.dropna()).most_common()}


def _text(value: object) -> str | None:
    return value if isinstance(value, str) and value else None

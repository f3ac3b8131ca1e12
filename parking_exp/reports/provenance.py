"""Provenance of a report: versions, commits, machines, configs, and the runs without a result."""

from collections import Counter
from collections.abc import Sequence

import pandas as pd

from parking_exp.config.cell_labels import can_matter, differing
from parking_exp.reports.report_data import FailedRun, Provenance
from parking_exp.reports.selection import Group

VERSION = "version."
SHORT_COMMIT = 10
REASONS = {"running": "under way", "interrupted": "interrupted or not begun; rerun the sweep"}


def provenance(
    groups: Sequence[Group],
    left_out: Sequence[str],
    uri: str,
) -> Provenance:
    """Return what exactly was run.

    Args:
        groups: the cells of the report.
        left_out: labels of the other cells of the experiments.
        uri: of the store, without passwords.
    """
    runs = pd.concat([group.runs for group in groups])
    versions = {
        str(column).removeprefix(VERSION): _counts(runs[column])
        for column in runs
        if str(column).startswith(VERSION) and runs[column].notna().any()
    }
    configs = [group.config for group in groups]
    difference = {key: [config.get(key) for config in configs] for key in differing(configs)}
    common = {key: value for key, value in configs[0].items() if key not in difference and key != "seed"}
    started, ended = runs["started"].dropna(), runs["ended"].dropna()
    return Provenance(
        versions=versions,
        commits=_commits(runs),
        machines=_counts(runs["cpu"]),
        difference=difference,
        common={key: value for key, value in common.items() if can_matter(key)},
        unfinished=[run for group in groups for run in _unfinished(group)],
        uri=uri,
        left_out=list(left_out),
        first=started.min().isoformat(timespec="seconds") if len(started) else None,
        last=ended.max().isoformat(timespec="seconds") if len(ended) else None,
    )


def _unfinished(group: Group) -> list[FailedRun]:
    found = []
    for run in group.runs[~group.runs["status"].isin(["done", "pruned"])].to_dict("records"):
        status = str(run["status"])
        reason = _text(run["error"]) or REASONS.get(status, "no reason is known")
        found.append(FailedRun(group.label, int(run["seed"]), status, reason, _text(run["run_dir"])))
    return found


def _commits(runs: pd.DataFrame) -> dict[str, int]:
    known = runs[runs["git_commit"].notna()]
    marks = known["git_dirty"].fillna(False).map({True: "+", False: ""})
    return _counts(known["git_commit"].astype(str).str[:SHORT_COMMIT] + marks.astype(str))


def _counts(values: pd.Series) -> dict[str, int]:
    return {str(value): count for value, count in Counter(values.dropna()).most_common()}


def _text(value: object) -> str | None:
    return value if isinstance(value, str) and value else None

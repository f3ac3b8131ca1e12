"""Where results come from: versions, commits, machines, configs, and the runs that have none."""

from collections import Counter
from collections.abc import Mapping, Sequence

import pandas as pd

from parking_exp.reports.data import FailedRun, Provenance
from parking_exp.reports.factors import can_matter, differing
from parking_exp.reports.selection import Group
from parking_exp.runs.state import RunState

VERSION = "version."
SHORT_COMMIT = 10
WORDS = {
    "running": "under way",
    "interrupted": "cut off; it goes on when the sweep is typed again",
    "pending": "not begun",
    "done": "the store lacks it; python scripts/status.py sync=true sends it",
}


def provenance(
    groups: Sequence[Group],
    left_out: Sequence[str],
    uri: str,
    unheard: Sequence[FailedRun],
) -> Provenance:
    """Return what exactly was run.

    Args:
        groups: the cells of the report.
        left_out: labels of the other cells of the experiments.
        uri: of the store, without passwords.
        unheard: runs that the store has not heard of.
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
        unfinished=[*(run for group in groups for run in _unfinished(group)), *unheard],
        uri=uri,
        left_out=list(left_out),
        first=started.min().isoformat(timespec="seconds") if len(started) else None,
        last=ended.max().isoformat(timespec="seconds") if len(ended) else None,
    )


def not_in_store(runs: pd.DataFrame, states: Mapping[str, RunState]) -> list[FailedRun]:
    """Return runs on this machine that a store lacks: all of the cells that it does not know, and those that are done.

    Args:
        runs: all that the store has of the experiments.
        states: of runs on this machine, by run directory.
    """
    cells, paths = set(zip(runs["experiment"], runs["cell"], strict=True)), set(runs["run_dir"])
    found = []
    for path, state in states.items():
        unknown = (state.experiment, state.cell) not in cells
        if unknown or (state.stage == "done" and path not in paths):
            reason = state.reason or WORDS.get(state.stage, "no reason is known")
            found.append(FailedRun(state.label, state.seed, state.stage, reason, path))
    return found


def _unfinished(group: Group) -> list[FailedRun]:
    found = []
    for run in group.runs[group.runs["status"] != "done"].to_dict("records"):
        status = str(run["status"])
        reason = _text(run["error"]) or WORDS.get(status, "no reason is known")
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

"""Sources of a report: results from a store that is brought up to date first, or from an export."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from parking_exp.config.paths import absolute, database, default_uri, is_same_store
from parking_exp.errors import ConfigError, ResultsError, plural
from parking_exp.runs.run_state import RunState

if TYPE_CHECKING:
    from parking_exp.reports.report_request import ReportRequest
    from parking_exp.reports.search_report import Tuning
    from parking_exp.results.frames import Results


@dataclass(frozen=True)
class ReportSource:
    """What a report is made of.

    Attributes:
        results: of its experiments.
        experiments: their names.
        untracked: runs that the store does not have.
        unsynced: a sentence for each thing that kept the store from being brought up to date.
        tuning: the search that an export has.
    """

    results: "Results"
    experiments: list[str]
    untracked: Sequence[RunState] = ()
    unsynced: Sequence[str] = ()
    tuning: "Tuning | None" = None


def from_store(request: "ReportRequest", show: Callable[[str], None]) -> ReportSource:
    """Return what the store has of the experiments that are asked for, after it got what it lacks.

    Raises:
        ConfigError: it has several, and none is named.
        ResultsError: it can't be read, or has none of them.
    """
    from parking_exp.reports.untracked import find_untracked

    show("syncing the store")
    unsynced = _sync(request)
    show("reading the store")
    results = _load(request)
    having = list(dict.fromkeys(results.runs["experiment"]))
    if request.experiments is None and len(having) > 1:
        raise ConfigError(f"experiment: the store has several; name one or more of {', '.join(having)}")
    untracked = find_untracked(results.runs, request.output_path, having)
    return ReportSource(results, request.experiments or having, untracked, unsynced)


def _sync(request: "ReportRequest") -> list[str]:
    """Send what the embedded store lacks of the runs in the output directory; say what it still lacks.

    Nothing is sent to a store that is typed.
    """
    from parking_exp.reports.untracked import run_paths
    from parking_exp.runs.directory import RunDirectory
    from parking_exp.tracking.mirror import recorded_in_step
    from parking_exp.tracking.sync_all import sync_all
    from parking_exp.tracking.tracker import later

    embedded = default_uri(request.output_path)
    uri = absolute(request.tracking.uri) if request.tracking.uri else embedded
    lost = (path := database(uri)) is not None and not path.exists()
    behind = [
        directory
        for directory in map(RunDirectory, run_paths(request.output_path, request.experiments))
        if (own := directory.tracking_uri) and is_same_store(own, uri) and (lost or not recorded_in_step(directory))
    ]
    if not is_same_store(uri, embedded):
        older = f"The store has an older state of {plural(len(behind), 'run')} in {request.output_path}"
        return [f"{older}; {later(request.output_path, uri)}."] if behind else []
    problems: dict[str, list[RunDirectory]] = {}
    for directory, problem in sync_all(behind, [uri]):
        if problem is not None:
            problems.setdefault(problem, []).append(directory)
    return [
        f"The store has not got all of {plural(len(runs), 'run')}, e.g. {runs[0].path}: {problem}."
        for problem, runs in problems.items()
    ]


def _load(request: "ReportRequest") -> "Results":
    """Load the results.

    Raises:
        ResultsError: there are none; it says how far the runs in the output directory are.
    """
    from parking_exp.reports.untracked import run_paths
    from parking_exp.results.frames import load
    from parking_exp.runs.run_state import read_state
    from parking_exp.runs.state_tables import name

    try:
        return load(request.experiments, uri=request.tracking.uri, output_dir=request.output_path)
    except ResultsError as error:
        here = [read_state(path) for path in run_paths(request.output_path, request.experiments or [])]
        if failed := [state for state in here if state.stage == "failed"]:
            reason = f"{plural(len(failed), 'run')} of it failed, e.g. {name(failed[0])}: {failed[0].reason}"
            raise ResultsError(f"{error}; {reason}") from error
        if here:
            hint = "`python scripts/status.py` tells how far that is, and with sync=true sends it to the store"
            raise ResultsError(
                f"{error}; {plural(len(here), 'run')} of it {'is' if len(here) == 1 else 'are'} here: {hint}"
            ) from error
        raise

"""Sync all runs that a store lacks or has an older state of; the store is asked which these are."""

from collections.abc import Iterable, Iterator, Sequence

from parking_exp.config.paths import absolute, database, is_same_store
from parking_exp.errors import plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.tracking.failures import is_store_failure, reason
from parking_exp.tracking.mirror import present_status, recorded_in_step, try_sync
from parking_exp.tracking.store import Store
from parking_exp.tracking.tracker import later


def sync_all(directories: Iterable[RunDirectory], uris: Sequence[str]) -> Iterator[tuple[RunDirectory, str | None]]:
    """Sync every run that its store lacks, or has an older state of, and that no process is working on.

    Args:
        directories: of the runs.
        uris: stores that may be written to. A run directory may come from elsewhere, and what it names as its store is
            no reason to connect there.

    Yields:
        Each run that was not in step, and what kept it from being so now, or None.
    """
    tracked: dict[str, list[RunDirectory]] = {}
    for directory in directories:
        if uri := directory.tracking_uri:
            tracked.setdefault(uri, []).append(directory)
    for uri, runs in tracked.items():
        if any(is_same_store(uri, absolute(one)) for one in uris):
            yield from _sync_to(uri, runs)
            continue
        for directory in runs:
            if not recorded_in_step(directory):
                yield directory, f"it is tracked in {uri}, which was not named; tracking.uri={uri} sends it there"


def sync_problem(directories: Iterable[RunDirectory], uris: Sequence[str]) -> str | None:
    """Sync all runs as `sync_all` does; return a sentence if a store has not got all of them, with what to type."""
    found = [(one, problem) for one, problem in sync_all(directories, uris) if problem]
    if not found:
        return None
    directory, problem = found[0]
    what_to_do = later(directory.output_dir, directory.tracking_uri)
    return f"the store has not got all of {plural(len(found), 'run')} ({problem}); {what_to_do}"


def in_step(directory: RunDirectory, known: dict[str, str]) -> bool:
    """Whether a store has all that it is to have of a run; `known` are the statuses of its runs, by run id."""
    return recorded_in_step(directory) and known.get(directory.run_id or "") == present_status(directory)


def known_statuses(uri: str, directories: Iterable[RunDirectory]) -> dict[str, str]:
    """Ask a store for the status of every run of the experiments of some run directories; a new store has none.

    Raises:
        Exception: the store can't be reached; see `failures.is_store_failure`.
    """
    path = database(uri)
    if path is not None and not path.exists():
        return {}
    known = list(directories)
    return Store(uri, known[0].output_dir).statuses({directory.path.parents[1].name for directory in known})


def _sync_to(uri: str, directories: list[RunDirectory]) -> Iterator[tuple[RunDirectory, str | None]]:
    try:
        known = known_statuses(uri, directories)
    except Exception as error:
        if not is_store_failure(error):
            raise
        # Not asked again for each run: a server that is down takes seconds to say so.
        yield from ((directory, reason(error)) for directory in directories if not directory.under_way)
        return
    # All are looked at before any is sent: the first one makes a store that was lost again.
    behind = [directory for directory in directories if not in_step(directory, known)]
    for directory in behind:
        if not directory.under_way:
            yield directory, try_sync(directory, uri)

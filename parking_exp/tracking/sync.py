"""Make MLflow stores agree with run directories: one run, or all that a store lacks."""

import shlex
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from filelock import FileLock

from parking_exp.config.paths import default_uri, is_same_store, resolved
from parking_exp.config.schema import RunConfig
from parking_exp.errors import StoreError, reason_of_store_failure
from parking_exp.phrases import plural
from parking_exp.runs.directory import SYNC_LOCK, RunDirectory
from parking_exp.runs.lookup import experiment_of
from parking_exp.runs.output_identity import output_id
from parking_exp.runs.run_files import STATUS_FILE
from parking_exp.terminal import command_of
from parking_exp.tracking.embedded_store import rebuild_if_unusable
from parking_exp.tracking.run_snapshot import (
    DIGEST,
    OUTPUT_ID,
    state_for_store,
)
from parking_exp.tracking.store import Store
from parking_exp.tracking.write_run import write_run

if TYPE_CHECKING:
    from mlflow.entities import Run

WAIT_S = 120  # for another process that syncs the same run


def sync_run(directory: RunDirectory, store: Store) -> None:
    """Make a store agree with a run directory; idempotent."""
    rebuild_if_unusable(store)
    with FileLock(directory.path / SYNC_LOCK, timeout=WAIT_S):
        write_run(directory, store)


def try_sync(directory: RunDirectory, store: Store) -> str | None:
    """Sync as far as the store allows; return the reason of a failure, or None.

    A failure stops no training, since the run directory has everything.
    """
    try:
        sync_run(directory, store)
    except Exception as error:
        return reason_of_store_failure(error)
    return None


def adopt_store(directory: RunDirectory, config: RunConfig) -> None:
    """Make the store of a command's config the store of a finished run; the next sync sends it.

    A run that is tracked elsewhere keeps its store, unless `tracking.uri` is given.
    """
    if not config.tracking.mlflow or directory.status != "done":
        return
    tracked_in = directory.tracking_uri
    is_chosen = config.tracking.uri is not None
    if tracked_in is None or (is_chosen and not is_same_store(tracked_in, config.store_uri)):
        directory.update_status(tracking_uri=config.store_uri)


def sync_missing(
    directories: Iterable[RunDirectory], store: Store
) -> Iterator[tuple[RunDirectory, str | None]]:
    """Sync the runs that a store lacks or has in an older state; one search finds them.

    Runs are sent while the caller iterates, so iterate to the end. Running runs are skipped. Only
    `store` is connected to: the stores that run directories name may come from other people.

    Yields:
        Each run that had to be sent, and why it could not be, or None.
    """
    directories = list(directories)
    for directory in directories:
        if directory.is_status_damaged:
            problem = f"{STATUS_FILE} can't be read; restore it, or rerun the command of the run"
            yield directory, problem
    tracked = [directory for directory in directories if store.tracks(directory)]
    idle = [directory for directory in tracked if not directory.is_locked]
    if not idle:
        return
    try:
        synced = _runs_by_state(idle, store)
    except Exception as error:
        problem = reason_of_store_failure(error)
        yield from ((directory, problem) for directory in idle)
        return
    for directory in idle:
        if not _is_stored(directory, store, synced):
            yield directory, try_sync(directory, store)


def _is_stored(
    directory: RunDirectory, store: Store, synced: "Mapping[tuple[Path, str | None], Run]"
) -> bool:
    """Return whether a store has a run as it is now; False if the run's files can't be read.

    `synced` has the store's runs by directory and digest.
    """
    with suppress(OSError):
        state = state_for_store(directory)
        run = synced.get((resolved(directory.path), state.digest))
        return run is not None and store.has_artifacts(run, state.files)
    return False


def complete_store(directories: Iterable[RunDirectory], store: Store) -> str | None:
    """Sync what a store lacks of some runs.

    Returns:
        A sentence with the command to run if the store still lacks some, or None.
    """
    problems = [item for item in sync_missing(directories, store) if item[1] is not None]
    if not problems:
        return None
    directory, problem = problems[0]
    incomplete = f"files and store differ for {plural(len(problems), 'run')}, e.g. {directory.path}"
    return f"{incomplete}: {problem}; {sync_hint(directory.output_dir, store.uri)}"


def sync_hint(output_dir: Path, uri: str) -> str:
    """Return the command that sends what a store lacks."""
    words = [*command_of("status").split(), "sync=true"]
    if output_dir != Path("outputs").absolute():
        words.append(f"output_dir={output_dir}")
    if uri != default_uri(output_dir):
        words.append(f"tracking.uri={uri}")
    return f"`{shlex.join(words)}` sends what is missing"


def delete_stored(directory: RunDirectory, store: Store) -> None:
    """Mark the stored runs of a run directory as deleted in MLflow.

    Raises:
        StoreError: the store fails.
    """
    try:
        own_id = None if store.is_in_output_dir else output_id(directory.output_dir)
        for run in _runs_of_experiments([directory], store):
            run_dir = store.run_dir(run)
            is_same = run_dir is not None and resolved(run_dir) == resolved(directory.path)
            has_same_owner = run.data.tags.get(OUTPUT_ID) == own_id
            if is_same and has_same_owner and run.info.lifecycle_stage != "deleted":
                with store.writing() as client:
                    client.delete_run(run.info.run_id)
    except Exception as error:
        problem = reason_of_store_failure(error)
        raise StoreError(
            f"{directory.path} is kept, since the store {store.uri} fails: {problem}"
        ) from error


def _runs_by_state(
    directories: Iterable[RunDirectory], store: Store
) -> "dict[tuple[Path, str | None], Run]":
    """Return the stored runs of the directories' experiments, by run directory and digest.

    The digest identifies a state of the run directory.
    """
    runs = {}
    for run in _runs_of_experiments(directories, store):
        run_dir = store.run_dir(run)
        if run_dir is not None:
            runs[resolved(run_dir), run.data.tags.get(DIGEST)] = run
    return runs


def _runs_of_experiments(directories: Iterable[RunDirectory], store: Store) -> "list[Run]":
    """Return all runs that a store has of the experiments of some directories."""
    rebuild_if_unusable(store)
    ids = store.experiment_ids()
    names = {experiment_of(directory.path) for directory in directories}
    return store.runs(ids[name] for name in names if name in ids)

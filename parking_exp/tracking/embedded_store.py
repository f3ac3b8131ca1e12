"""The store inside an output directory, rebuilt from the run directories if it can't be used.

It can't be used if it is missing, if its creation was interrupted, or if the output directory was
moved or copied: MLflow stores absolute locations of artifacts, which its client can't change. A
store that contains runs of others, or that a newer MLflow has made, is never replaced.
"""

import os
import secrets
import shutil
from pathlib import Path

from rich.progress import track

from parking_exp.config.paths import ARTIFACTS, SQLITE
from parking_exp.errors import StoreError, reason_of_store_failure
from parking_exp.garbage_collection import no_garbage_collection
from parking_exp.phrases import plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.terminal import make_console, say
from parking_exp.tracking.client import lock_path, write_lock
from parking_exp.tracking.store import MAX_EXPERIMENTS, OUTPUT_DIR_TAG, Store
from parking_exp.tracking.write_run import write_new_run

FEW_RUNS = 20  # fewer runs are written without a progress bar
MOVE_IT = (
    "move it away, and the next command makes one from the run directories; or name a store with "
    "tracking.uri="
)


def rebuild_if_unusable(store: Store) -> None:
    """Rebuild an output directory's store from its run directories, unless it can be used.

    Raises whatever MLflow, SQLAlchemy or the disk raise.
    """
    path = store.embedded_database
    if path is None or (store.is_checked and path.exists()):
        return
    store.refuse_link()
    output_dir = path.parent
    output_dir.mkdir(parents=True, exist_ok=True)
    if os.access(output_dir, os.W_OK):  # who can't write may still read
        with write_lock(store.uri):
            if not _is_usable(path):
                _build(store, path)
    store.is_checked = True


def _build(store: Store, path: Path) -> None:
    """Make a store from the run directories beside its database, and replace an existing one.

    The store is made under a temporary name, then renamed. Runs that can't be written are reported
    and left to the next sync.
    """
    output_dir = path.parent
    _remove_unfinished(path)
    _set_aside(path)
    # A new name, since MLflow remembers which stores it has made.
    unfinished = path.with_name(f"{path.name}.build-{secrets.token_hex(4)}")
    new = Store(f"{SQLITE}{unfinished}", output_dir)
    new.experiment_ids()  # which makes it, even for no run
    directories = [RunDirectory(run_dir) for run_dir in find_runs(output_dir)]
    tracked = [directory for directory in directories if store.tracks(directory)]
    progress = track(
        tracked,
        "making the store",
        console=make_console(stderr=True),
        transient=True,
        disable=len(tracked) < FEW_RUNS,
    )
    experiment_ids: dict[str, str] = {}
    problems = []
    for directory in progress:
        try:
            with no_garbage_collection():
                write_new_run(directory, new, store.uri, experiment_ids)
        except Exception as error:  # this run can't be written; the others are
            problems.append(f"{directory.path}: {reason_of_store_failure(error)}")
    unfinished.replace(path)
    lock_path(unfinished).unlink(missing_ok=True)
    if problems:
        say(f"the new store lacks {plural(len(problems), 'run')}, e.g. {problems[0]}", stderr=True)


def _is_usable(path: Path) -> bool:
    """Return whether a store can be used where it is; if not, it may be replaced.

    Raises:
        StoreError: a newer MLflow made it, or it can't be used but contains runs of others.
        Exception: any other error of MLflow, SQLAlchemy or the disk.
    """
    if not path.exists():
        return False
    store = Store(f"{SQLITE}{path}", None)
    try:
        experiments = store.client.search_experiments(max_results=MAX_EXPERIMENTS)
    except Exception as error:
        text = reason_of_store_failure(error)
        if "out-of-date database schema" in text:  # MLflow adds what an older one lacks
            raise StoreError(
                f"{path} was made by another version of MLflow; install that, or {MOVE_IT}"
            ) from error
        if text.endswith("already exists"):  # as tables of interrupted migrations do
            return False
        raise
    output_dirs = {experiment.tags.get(OUTPUT_DIR_TAG) for experiment in experiments}
    if output_dirs <= {None, str(path.parent)}:  # it is where it was made
        return True
    _refuse_content_of_others(store, path)
    return False


def _set_aside(path: Path) -> None:
    """Rename a store and its artifacts to `*.replaced-N`, and say so."""
    output_dir = path.parent
    number = 1
    while any(output_dir.glob(f"*.replaced-{number}")):
        number += 1
    for old in (path, output_dir / ARTIFACTS):
        if old.exists():
            kept = old.rename(old.with_name(f"{old.name}.replaced-{number}"))
            say(
                f"{old} can't be used here and is made again; the old one is {kept.name}",
                stderr=True,
            )


def _remove_unfinished(path: Path) -> None:
    """Remove stores that processes were making when they were killed, with their artifacts."""
    output_dir = path.parent
    leftovers = list(output_dir.glob(f"*{path.name}.build-*"))
    if any(leftover.suffix != ".lock" for leftover in leftovers):  # else the store was complete
        shutil.rmtree(output_dir / ARTIFACTS, ignore_errors=True)
    for leftover in leftovers:
        leftover.unlink(missing_ok=True)


def _refuse_content_of_others(store: Store, path: Path) -> None:
    """Raise StoreError if a store has runs that are not of the run directories beside it."""
    from mlflow.entities import ViewType

    experiments = store.client.search_experiments(ViewType.ALL, max_results=MAX_EXPERIMENTS)
    for run in store.search([experiment.experiment_id for experiment in experiments]):
        run_dir = run.data.tags.get("run_dir")
        if run_dir is None or Path(run_dir).is_absolute():
            raise StoreError(
                f"{path} can't be used here, and has runs of others, e.g. {run.info.run_id}; "
                f"{MOVE_IT}"
            )

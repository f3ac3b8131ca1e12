"""Sync the runs of a sweep while their workers train, which write run directories only."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from parking_exp.errors import ParkingError
from parking_exp.runs.directory import RunDirectory
from parking_exp.tracking.store_writer import StoreWriter, SyncPoint, sync_point

POLL_S = 1.0
PAUSE_S = 60.0  # until a run that could not be synced is tried again: that could take minutes


@contextmanager
def syncing(find: Callable[[], Sequence[Path]], writer: StoreWriter) -> Iterator[None]:
    """Sync runs in a thread as they save checkpoints and end; at last, sync all that is missing.

    Args:
        find: returns the run directories that exist now.
        writer: the writer of their stores.
    """
    if not writer.stores:
        yield
        return
    synced = {path: sync_point(RunDirectory(path)) for path in find()}
    is_over = threading.Event()
    thread = threading.Thread(target=_watch, args=(find, writer, synced, is_over), daemon=True)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
        writer.complete_stores([RunDirectory(path) for path in find()])


def _watch(
    find: Callable[[], Sequence[Path]],
    writer: StoreWriter,
    synced: dict[Path, SyncPoint],
    is_over: threading.Event,
) -> None:
    """Sync the runs that have a new checkpoint or have ended, until it is over."""
    paused_until: dict[Path, float] = {}
    while not is_over.wait(POLL_S):
        try:
            paths = find()
        except (OSError, ParkingError):  # e.g. a folder that is being deleted: look again
            continue
        for path in paths:
            if is_over.is_set():
                return
            directory = RunDirectory(path)
            point = sync_point(directory)
            if point == synced.get(path) or time.monotonic() < paused_until.get(path, 0.0):
                continue
            status, checkpoint = point
            if checkpoint is not None or status not in ("pending", "running"):
                writer.sync(directory)
            if path in writer.problems:
                paused_until[path] = time.monotonic() + PAUSE_S
            else:
                synced[path] = point

"""Write runs to their stores while they train; a store that fails stops no training."""

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from parking_exp.config.schema import RunConfig
from parking_exp.errors import ParkingError
from parking_exp.runs.checkpoint_files import find_checkpoints
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_files import Status
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import complete_store, sync_hint, try_sync

POLL_S = 1.0
# A run that could not be synced is tried again after PAUSE_S, or after PAUSE_RATIO times the
# duration of the last try if that is longer. A try may take minutes, and a run in this process
# waits for it.
PAUSE_S = 60.0
PAUSE_RATIO = 10
SyncPoint = tuple[Status, str | None]
"""Status of a run, and the name of its newest checkpoint."""


class StoreWriter:
    """Writes runs to their stores, in the process that the user started.

    Args:
        configs: all configs of the runs, or some that name the same stores.
        say: shows a line.
    """

    def __init__(self, configs: Iterable[RunConfig], say: Callable[[str], None]) -> None:
        self._say = say
        tracked = [config for config in configs if config.tracking.mlflow]
        output_dirs = {config.store_uri: config.output_path for config in tracked}
        self._stores = [Store(uri, output_dir) for uri, output_dir in output_dirs.items()]
        self._synced: dict[Path, SyncPoint] = {}
        self._next_try: dict[Path, float] = {}

    @property
    def has_failed(self) -> bool:
        """Whether the last sync of a run has failed, so that a store may lack something."""
        return bool(self._next_try)

    def sync(self, directory: RunDirectory) -> None:
        """Sync a run to its store, unless nothing has changed or the last try has just failed."""
        self._sync(directory, _sync_point(directory))

    def _sync(self, directory: RunDirectory, point: SyncPoint) -> None:
        path = directory.path
        is_paused = time.monotonic() < self._next_try.get(path, 0.0)
        if is_paused or point == self._synced.get(path):
            return
        for store in self._stores:
            if not store.tracks(directory):
                continue
            began = time.monotonic()
            problem = try_sync(directory, store)
            took = time.monotonic() - began
            if problem is None:
                self._synced[path] = point
                self._next_try.pop(path, None)
            elif point == _sync_point(directory):  # else the run went on and changed its files
                if not self.has_failed:
                    hint = sync_hint(directory.output_dir, store.uri)
                    self._say(
                        f"the store {store.uri} is incomplete ({problem}); training continues, and "
                        f"{hint}"
                    )
                pause = max(PAUSE_S, PAUSE_RATIO * took)
                self._next_try[path] = began + took + pause

    def complete_stores(self, directories: Sequence[RunDirectory]) -> None:
        """Sync what the stores lack of some runs, and say if they still lack some."""
        for store in self._stores:
            problem = complete_store(directories, store)
            if problem is not None:
                self._say(problem)

    @contextmanager
    def syncing(self, find_run_dirs: Callable[[], Sequence[Path]]) -> Iterator[None]:
        """Sync runs in a thread as they save checkpoints and end; at last, all that is missing.

        `find_run_dirs` returns the run directories that exist now.
        """
        if not self._stores:
            yield
            return
        for path in find_run_dirs():
            self._synced[path] = _sync_point(RunDirectory(path))
        is_over = threading.Event()
        thread = threading.Thread(target=self._watch, args=(find_run_dirs, is_over), daemon=True)
        thread.start()
        try:
            yield
        finally:
            is_over.set()
            thread.join()
            self.complete_stores([RunDirectory(path) for path in find_run_dirs()])

    def _watch(self, find_run_dirs: Callable[[], Sequence[Path]], is_over: threading.Event) -> None:
        """Sync the runs that have a new checkpoint or have ended, until it is over."""
        while not is_over.wait(POLL_S):
            try:
                paths = find_run_dirs()
            except (OSError, ParkingError):  # e.g. a folder that is being deleted: look again
                continue
            for directory in map(RunDirectory, paths):
                point = _sync_point(directory)
                status, checkpoint = point
                is_begun = checkpoint is not None or status not in ("pending", "running")
                if is_begun and not is_over.is_set():
                    self._sync(directory, point)


def _sync_point(directory: RunDirectory) -> SyncPoint:
    """Return a run's status and its newest checkpoint.

    There is something to sync when they have changed.
    """
    checkpoints = find_checkpoints(directory.checkpoints)
    newest = checkpoints[-1].name if checkpoints else None
    return directory.status, newest

"""Write the runs of a sweep to their stores; their workers write run directories only."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Self

from parking_exp.config.paths import is_same_store
from parking_exp.config.schema import RunConfig
from parking_exp.runs.directory import RunDirectory, Status
from parking_exp.tracking.client import reason
from parking_exp.tracking.mirror import mirror, mirror_problem
from parking_exp.tracking.store import Store

POLL_S = 1.0
PAUSE_S = 60.0  # after a failure of the store: an attempt could take minutes

Moment = tuple[Status, str | None]
"""Status of a run, and the name of its newest checkpoint."""


class StoreWriter:
    """Context manager that sends runs to their stores as they save checkpoints and when they end.

    It works in a thread, and sends at the end whatever the stores still lack. A store that fails
    stops no training.

    Args:
        find: returns the run directories that exist now.
        configs: of the runs, or of some that have the same stores.
        say: shows a line.
    """

    def __init__(
        self,
        find: Callable[[], Sequence[Path]],
        configs: Iterable[RunConfig],
        say: Callable[[str], None],
    ) -> None:
        self._find, self._say = find, say
        output_dirs = {
            config.store_uri: config.output_path for config in configs if config.tracking.mlflow
        }
        self._stores = [Store(uri, output_dir) for uri, output_dir in output_dirs.items()]
        self._sent: dict[Path, Moment] = {path: _moment(RunDirectory(path)) for path in find()}
        self._resumes_at = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> Self:
        if self._stores:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if not self._stores:
            return
        self._over.set()
        self._thread.join()
        directories = [RunDirectory(path) for path in self._find()]
        for store in self._stores:
            if problem := mirror_problem(directories, store):
                self._say(problem)

    def _watch(self) -> None:
        while not self._over.wait(POLL_S):
            for path in self._find():
                if self._over.is_set() or time.monotonic() < self._resumes_at:
                    break
                self._send(RunDirectory(path))

    def _send(self, directory: RunDirectory) -> None:
        """Send a run if it has a new checkpoint or has ended."""
        moment = _moment(directory)
        if moment == self._sent.get(directory.path):
            return
        status, checkpoint = moment
        store = self._store_of(directory)
        if store is not None and (checkpoint is not None or status not in ("pending", "running")):
            try:
                mirror(directory, store)
            except Exception as error:
                if _moment(directory) != moment:  # it went on, and its files with it
                    return
                self._resumes_at = time.monotonic() + PAUSE_S
                self._say(f"the store {store.uri} lacks some of {directory.path}: {reason(error)}")
                return
        self._sent[directory.path] = moment

    def _store_of(self, directory: RunDirectory) -> Store | None:
        """Return the store of this sweep that a run is tracked in, if any."""
        uri = directory.tracking_uri
        if uri is None:
            return None
        return next((store for store in self._stores if is_same_store(uri, store.uri)), None)


def _moment(directory: RunDirectory) -> Moment:
    checkpoints = sorted(folder.name for folder in directory.checkpoints.glob("step=*"))
    return directory.status, checkpoints[-1] if checkpoints else None

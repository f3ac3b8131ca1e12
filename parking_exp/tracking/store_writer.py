"""Write runs to their stores while they train; a store that fails stops no training."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from parking_exp.config.schema import RunConfig
from parking_exp.runs.checkpoint_files import find_checkpoints
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_files import Status
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import complete_store, sync_hint, try_sync

SyncPoint = tuple[Status, str | None]
"""Status of a run, and the name of its newest checkpoint."""


class StoreWriter:
    """Writes runs to their stores, in the process that the user started.

    Args:
        configs: all configs of the runs, or some that name the same stores.
        say: shows a line.

    Attributes:
        stores: the stores of the runs.
        problems: the reason for each run whose last sync failed.
    """

    def __init__(self, configs: Iterable[RunConfig], say: Callable[[str], None]) -> None:
        self.problems: dict[Path, str] = {}
        self._say = say
        tracked = [config for config in configs if config.tracking.mlflow]
        output_dirs = {config.store_uri: config.output_path for config in tracked}
        self.stores = [Store(uri, output_dir) for uri, output_dir in output_dirs.items()]

    def sync(self, directory: RunDirectory) -> None:
        """Make the store of a run agree with it, and say if that fails for the first time."""
        for store in self.stores:
            if store.tracks(directory):
                self._sync(directory, store)

    def sync_in_training(self, directory: RunDirectory) -> None:
        """Sync a run that waits for it: after a failure at its end only, as it may take minutes."""
        if not self.problems or directory.status != "running":
            self.sync(directory)

    def _sync(self, directory: RunDirectory, store: Store) -> None:
        point = sync_point(directory)
        problem = try_sync(directory, store)
        if problem is None:
            had_failed = self.problems.pop(directory.path, None)
            if had_failed and not self.problems:
                self._say("the store is complete again")
        elif sync_point(directory) == point:  # else it went on, and its files with it
            if not self.problems:
                hint = sync_hint(directory.output_dir, store.uri)
                self._say(
                    f"the store {store.uri} is incomplete ({problem}); training continues, and "
                    f"{hint}"
                )
            self.problems[directory.path] = problem

    def complete_stores(self, directories: Sequence[RunDirectory]) -> None:
        """Sync what the stores lack of some runs, and say if they still lack some."""
        for store in self.stores:
            problem = complete_store(directories, store)
            if problem is not None:
                self._say(problem)


def sync_point(directory: RunDirectory) -> SyncPoint:
    """Return where a run is: it changes whenever there is something to sync."""
    checkpoints = find_checkpoints(directory.checkpoints)
    newest = checkpoints[-1].name if checkpoints else None
    return directory.status, newest

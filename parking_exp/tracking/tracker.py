"""Log a training to its store; a store that fails does not stop it."""

import time
from collections.abc import Callable

from parking_exp.config.schema import RunConfig
from parking_exp.runs.atomic_files import read_object, write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_provenance import PROVENANCE_FILE, collect_provenance
from parking_exp.tracking.mirror import sync_hint, try_mirror
from parking_exp.tracking.store import Store


class Tracker:
    """Mirrors a run to its store, if it has one; after a failure it retries only at the end of the run."""

    def __init__(self, config: RunConfig, directory: RunDirectory, say: Callable[[str], None]) -> None:
        self.uri = config.store_uri if config.tracking.mlflow else None
        self.directory, self.say = directory, say
        self.problem: str | None = None

    def begin(self) -> None:
        """Write the provenance of this process, which trains the run, and mirror the run."""
        self.directory.update(tracking_uri=self.uri)
        if self.uri is not None:
            path = self.directory.path / PROVENANCE_FILE
            started_ms = read_object(path).get("started_ms") or time.time_ns() // 1_000_000
            write_json(path, {"started_ms": started_ms, "tags": collect_provenance()})
            self.mirror()

    def sync(self) -> None:
        """Mirror a new checkpoint, unless the store has failed: each attempt could take minutes."""
        if self.problem is None:
            self.mirror()

    def mirror(self) -> None:
        """Mirror the run as it is, at its start and after its last status is written."""
        if self.uri is None:
            return
        before, self.problem = self.problem, try_mirror(self.directory, Store(self.uri, self.directory.output_dir))
        if before and self.problem is None:
            self.say("the store is complete again")
        elif self.problem and before is None:
            hint = sync_hint(self.directory.output_dir, self.uri)
            self.say(f"the store {self.uri} is incomplete ({self.problem}); training continues, and {hint}")

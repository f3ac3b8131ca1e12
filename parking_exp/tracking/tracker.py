"""Log a training to its store; a store that fails does not stop it."""

import shlex
import time
from collections.abc import Callable
from pathlib import Path

from parking_exp.config.paths import default_uri, store_uri
from parking_exp.config.schema import RunConfig
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_provenance import PROVENANCE_FILE, provenance, read_provenance
from parking_exp.tracking.mirror import try_sync

# Between attempts at a store that fails: so that no more than a twentieth of a training's time goes there.
SHORTEST_PAUSE_S, PAUSE_TO_ATTEMPT = 30.0, 20.0


def later(output_dir: Path, uri: str | None) -> str:
    """Return what to type when a store lacks something; `uri` is the store, None for the embedded one."""
    words = ["python", "scripts/status.py", "sync=true"]
    if output_dir != Path("outputs").absolute():
        words.append(f"output_dir={output_dir}")
    if uri is not None and uri != default_uri(output_dir):
        words.append(f"tracking.uri={uri}")
    return f"`{shlex.join(words)}` sends what is missing"


class Tracker:
    """Null tracker, of a run without a store; base of `MlflowTracker`."""

    def sync(self) -> None:
        """Send what has become final; to be called after each checkpoint."""

    def close(self) -> None:
        """Send everything; to be called when the run's last status is written."""


class MlflowTracker(Tracker):
    """Tracks a run in MLflow. After a failure the store is not tried again for a while, with one message."""

    def __init__(self, uri: str, directory: RunDirectory, say: Callable[[str], None]) -> None:
        self.uri, self.directory, self.say = uri, directory, say
        self.problem: str | None = None
        self._next_attempt = 0.0
        self._attempt()

    def sync(self) -> None:
        """Send what has become final, unless the store has just failed."""
        if time.monotonic() >= self._next_attempt:
            self._attempt()

    def close(self) -> None:
        """Send everything, also where the store has just failed."""
        self._attempt()

    def _attempt(self) -> None:
        start, before = time.monotonic(), self.problem
        self.problem = try_sync(self.directory, self.uri)
        now = time.monotonic()
        if self.problem is None:
            self._next_attempt = 0.0
            if before:
                self.say("the store has everything now")
            return
        self._next_attempt = now + max(SHORTEST_PAUSE_S, PAUSE_TO_ATTEMPT * (now - start))
        if before is None:
            what_to_do = later(self.directory.output_dir, self.uri)
            self.say(f"the store {self.uri} has not got everything ({self.problem}); the run goes on, and {what_to_do}")


def open_tracker(config: RunConfig, directory: RunDirectory, say: Callable[[str], None] = print) -> Tracker:
    """Return the run's tracker; `say` prints a sentence for the user."""
    if not config.tracking.mlflow:
        directory.update(tracking_uri=None)
        return Tracker()
    # Of the process that trains, not of one that syncs later.
    path = directory.path / PROVENANCE_FILE
    started_ms = read_provenance(path)[0] or time.time_ns() // 1_000_000
    write_json(path, {"started_ms": started_ms, "tags": provenance()})
    uri = store_uri(config)
    directory.update(tracking_uri=uri)
    return MlflowTracker(uri, directory, say)

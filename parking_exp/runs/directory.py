"""Run directories: what lies where, how far a run is, and which process may change it.

    outputs/<experiment_name>/<cell>/seed=<n>/
        config.yaml  status.json  result.json  metrics.jsonl  episodes.csv  monitor.csv  progress.csv
        provenance.json  trajectories.npz  checkpoints/  models/  evaluations/  exports/  tensorboard/  video.mp4
        curves.png  log.txt  beat.json  traceback.txt

The run directory is the truth; MLflow is its index. Two locks keep processes apart: `.claim` is held by the process
that is responsible for the run (its supervisor, or the one that trains it without any), `.lock` by the one that trains.
"""

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock
from pydantic import TypeAdapter, ValidationError

from parking_exp.config.credentials import strip_password
from parking_exp.config.paths import absolute, directory_path, refuse_links, relative, store_uri
from parking_exp.config.schema import RunConfig
from parking_exp.errors import OutputDirectoryError, RunLockedError
from parking_exp.runs.atomic_files import read_object, replacing, write_json
from parking_exp.runs.locks import hold, is_held
from parking_exp.runs.run_provenance import command_line
from parking_exp.runs.status_schema import Status, StatusEntries, read_entries
from parking_exp.runs.stored_config import OUTPUT_DIR, read_config, write_config

STATUS_FILE, RESULT_FILE, HEARTBEAT_FILE = "status.json", "result.json", "beat.json"
MODEL, BUFFER, MANIFEST = "model.zip", "replay_buffer.npz", "manifest.json"  # of a checkpoint
SUPERVISOR_LOCK, TRAINING_LOCK = ".claim", ".lock"
# To see whether a lock is held, it is taken for a moment: who wants to hold it tries again for this long.
LOCK_PATIENCE_S = 2.0
# A supervisor that is killed takes its worker with it; until it is gone, the next one waits.
WORKER_PATIENCE_S = 20.0
# Space that a run keeps while it trains, so that its end can be written down on a disk that is full by then.
RESERVE, RESERVE_BYTES = ".reserve", 64 * 1024
ENDS = ("done", "failed", "interrupted", "pruned")


@dataclass(frozen=True)
class RunResult:
    """What a finished run came to.

    Attributes:
        run_dir: absolute run directory.
        run_id: MLflow run id; None without MLflow.
        steps: env steps trained.
        metrics: last value of every metric, `final/success_rate` among them.
    """

    run_dir: str
    run_id: str | None
    steps: int
    metrics: dict[str, float]


class RunDirectory:
    """The directory of one run; `models` holds the best and the final one."""

    def __init__(self, path: Path) -> None:
        self.path, self.checkpoints, self.models = path, path / "checkpoints", path / "models"

    @property
    def output_dir(self) -> Path:
        """The output directory that the run is in now: it may have been moved since the run was written."""
        return directory_path(self.path / OUTPUT_DIR)

    @property
    def status(self) -> Status:
        """Status in status.json. A run that was killed still says `running`; its lock is free."""
        return self.read_status().get("status", "pending")

    @property
    def run_id(self) -> str | None:
        """MLflow run id, once the run has one."""
        return self.read_status().get("run_id")

    @property
    def tracking_uri(self) -> str | None:
        """Store that the run is tracked in; None where it is not tracked."""
        uri = self.read_status().get("tracking_uri")
        return strip_password(absolute(uri, self.output_dir)) if uri else None

    @property
    def unsynced(self) -> str | None:
        """Why the store lacks something of the run; None as far as is known."""
        return self.read_status().get("unsynced")

    @property
    def under_way(self) -> bool:
        """Whether a process, be it this one, is responsible for the run now, or works on it."""
        return any(is_held(self.path / name) for name in (SUPERVISOR_LOCK, TRAINING_LOCK))

    def update(self, durable: bool = True, /, **values: Any) -> None:
        """Change entries of status.json; None removes one."""
        if uri := values.get("tracking_uri"):
            values["tracking_uri"] = relative(uri, self.output_dir)
        if values.get("status") in ENDS:
            (self.path / RESERVE).unlink(missing_ok=True)
        # A training, its supervisor, a mirror and an evaluation may change different entries at once.
        with FileLock(self.path / ".status.lock"):
            changed = {**self.read_status(), **values}
            kept = {key: value for key, value in changed.items() if value is not None}
            write_json(self.path / STATUS_FILE, kept, durable=durable)

    def result(self) -> RunResult | None:
        """Return the stored result of a finished run, else None, also where it is damaged."""
        stored = read_object(self.path / RESULT_FILE)
        if not stored or self.status != "done":
            return None
        # The store may have been down until later, and the directory moved.
        known = {**stored, "run_dir": str(self.path.absolute()), "run_id": self.run_id}
        with suppress(ValidationError):
            return TypeAdapter(RunResult).validate_python(known)
        return None

    def finish(self, result: RunResult, **values: Any) -> None:
        """Store the result, and entries of status.json; from here on the run is done."""
        write_json(self.path / RESULT_FILE, asdict(result))
        self.update(status="done", steps=result.steps, **values)

    def create(self, config: RunConfig) -> None:
        """Make the directory, write the resolved config into it, and reserve space for the run's end.

        Raises:
            OutputDirectoryError: it can't be written.
        """
        with self._writable():
            write_config(self.path, config, durable=True)
        self.reserve()

    def reserve(self) -> None:
        """Take up the space in which the run's end can be written, until that is done.

        Raises:
            OutputDirectoryError: there is not as much left.
        """
        with self._writable(), replacing(self.path / RESERVE, durable=False) as temporary:
            temporary.write_bytes(os.urandom(RESERVE_BYTES))  # what can't be compressed

    def freeze(
        self,
        config: RunConfig,
        label: str,
        started: float | None,
        entries: Mapping[str, Any] | None = None,
    ) -> None:
        """Freeze the config and the label of a pending run; later edits to the config do not affect it.

        A run that another process has taken up meanwhile is left as it is: one that is under way, or was begun at
        another time than `started`. Nothing is synced to the disk: after a power cut, rerunning the sweep writes it
        again. `entries` go into status.json as well.

        Raises:
            OutputDirectoryError: the directory can't be written.
        """
        if self.under_way:
            return
        with suppress(RunLockedError), self._held(SUPERVISOR_LOCK, LOCK_PATIENCE_S):
            known = self.read_status()
            if known.get("status") == "done" or known.get("started") != started:
                return
            with self._writable():
                write_config(self.path, config, durable=False)
            known = {"label": label, "total_timesteps": config.total_timesteps, "command": command_line()}
            uri = store_uri(config) if config.tracking.mlflow else None
            fresh = {"status": "pending", "error": None, "killed": None, "tracking_uri": uri}
            self.update(False, **fresh, **known, **(entries or {}))

    def heartbeat(self, **values: Any) -> None:
        """Write down how far the run is, for processes that watch it."""
        with suppress(OSError):  # a full disk: nothing depends on a heartbeat, and the next checkpoint will fail
            write_json(self.path / HEARTBEAT_FILE, {"time": time.time(), **values}, durable=False)

    def config(self) -> RunConfig:
        """Read the run's config, with the output directory and store of where the run is now.

        Raises:
            ConfigError: it is missing, damaged, or does not fit the schema.
        """
        return read_config(self.path, self.output_dir)

    def check_links(self) -> None:
        """Refuse a run directory with links to files elsewhere, which would be written to or sent to a store.

        Raises:
            UntrustedError: it has a symbolic link that leads out of it.
        """
        refuse_links(self.path.rglob("*"), self.path)

    @contextmanager
    def supervisor_lock(self) -> Iterator[None]:
        """Be the process that is responsible for the run.

        Raises:
            RunLockedError: another process is.
            OutputDirectoryError: the directory cannot be made.
            UntrustedError: a symbolic link leads out of it.
        """
        with self._held(SUPERVISOR_LOCK, LOCK_PATIENCE_S):
            yield

    @contextmanager
    def training_lock(self) -> Iterator[None]:
        """Be the process that trains the run; raises what `supervisor_lock` does."""
        with self._held(TRAINING_LOCK, WORKER_PATIENCE_S):
            yield

    @contextmanager
    def _held(self, name: str, patience_s: float) -> Iterator[None]:
        with self._writable():
            self.path.mkdir(parents=True, exist_ok=True)
        with hold(self.path / name, patience_s):
            self.check_links()
            yield

    @contextmanager
    def _writable(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputDirectoryError(f"output_dir: {self.path} cannot be written: {error.strerror}") from error

    def read_status(self) -> dict[str, Any]:
        """Return the entries of status.json; one of the wrong type is none."""
        return read_entries(self.path / STATUS_FILE, StatusEntries)[0]

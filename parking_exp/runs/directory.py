"""Run directories: layout, progress, and the locks of the processes that change them.

    outputs/<experiment_name>/<cell>/seed=<n>/
        config.yaml  status.json  result.json  metrics.jsonl  episodes.csv  paths.csv.gz
        monitor.csv  progress.csv  provenance.json  checkpoints/  models/  evaluations/
        exports/  tensorboard/  video.mp4  curves.png  log.txt  beat.json  traceback.txt

The run directory is the source of truth; the store is a copy. Two locks keep processes apart. The
process that is responsible for the run holds `.claim`: its supervisor, or the training process if
there is no supervisor. The process that trains holds `.lock`.
"""

import os
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from pydantic import TypeAdapter, ValidationError

from parking_exp.config.paths import absolute_path, absolute_uri, refuse_links, relative_uri
from parking_exp.config.schema import RunConfig
from parking_exp.errors import OutputDirectoryError, RunLockedError
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.checkpoint_files import CHECKPOINTS, checkpoint_name, checkpoint_problem
from parking_exp.runs.file_hashes import HASHES, hash_finished_files
from parking_exp.runs.foreign_files import read_object
from parking_exp.runs.locks import is_held
from parking_exp.runs.run_files import (
    HEARTBEAT_FILE,
    MODELS,
    OUTPUT_DIR_FROM_RUN,
    RESULT_FILE,
    STATUS_FILE,
    TRACEBACK_FILE,
    VIDEO_FILE,
    Status,
    StatusEntries,
    read_config,
    read_entries,
    write_config,
)
from parking_exp.runs.run_provenance import PROVENANCE_FILE
from parking_exp.terminal import command_of

SUPERVISOR_LOCK = ".claim"
TRAINING_LOCK = ".lock"
STATUS_LOCK = ".status.lock"
SYNC_LOCK = ".sync.lock"
LOCK_PATIENCE_S = 2.0  # another process takes a lock for a moment to see whether it is held
WORKER_PATIENCE_S = 20.0  # the worker of a supervisor that was killed ends soon after it
# A run reserves disk space while it trains, so that it can record its end on a full disk.
RESERVE = ".reserve"
RESERVE_BYTES = 64 * 1024
ENDS = ("done", "failed", "interrupted")


@dataclass(frozen=True)
class RunResult:
    """The result of a finished run."""

    run_dir: str  # absolute
    run_id: str | None  # MLflow's; None without it
    steps: int  # env steps trained
    metrics: dict[str, float]  # last value of every metric, `final/success_rate` among them


class RunDirectory:
    """The directory of one run."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.checkpoints = path / CHECKPOINTS
        self.models = path / MODELS

    @property
    def output_dir(self) -> Path:
        """The output directory that the run is in now."""
        return absolute_path(self.path / OUTPUT_DIR_FROM_RUN)

    @property
    def status(self) -> Status:
        """Status in status.json; a run that was killed is still `running` there."""
        return self.read_status().status or "pending"

    @property
    def is_status_damaged(self) -> bool:
        """Whether status.json can't be read."""
        return read_entries(self.path / STATUS_FILE, StatusEntries) is None

    @property
    def run_id(self) -> str | None:
        """MLflow run id, once the run has one."""
        return self.read_status().run_id

    @property
    def tracking_uri(self) -> str | None:
        """Store that the run is tracked in; None where it is not tracked."""
        uri = self.read_status().tracking_uri
        return absolute_uri(uri, self.output_dir) if uri else None

    @property
    def is_locked(self) -> bool:
        """Whether a process, this one included, holds one of the run's locks."""
        return is_held(self.path / SUPERVISOR_LOCK) or is_held(self.path / TRAINING_LOCK)

    def update_status(self, *, durable: bool = True, **values: Any) -> None:
        """Change entries of `status.json`; the value None removes an entry.

        A store URI is made relative. A status that ends the run also frees its reserved space.
        """
        uri = values.get("tracking_uri")
        if uri is not None:
            values["tracking_uri"] = relative_uri(uri, self.output_dir)
        if values.get("status") in ENDS:
            (self.path / RESERVE).unlink(missing_ok=True)
        # Several processes change entries: a training, its supervisor, a sync.
        with FileLock(self.path / STATUS_LOCK):
            changed = self.read_status().model_copy(update=values)
            entries = changed.model_dump(exclude_none=True)
            write_json(self.path / STATUS_FILE, entries, durable=durable)

    def read_result(self) -> RunResult | None:
        """Return the stored result of a finished run; None if there is none, or it is damaged."""
        entries = self.read_status()
        if entries.status != "done":
            return None
        stored = read_object(self.path / RESULT_FILE)
        stored["run_dir"] = str(self.path.absolute())
        stored["run_id"] = entries.run_id
        try:
            return TypeAdapter(RunResult).validate_python(stored)
        except ValidationError:
            return None

    def finish(self, steps: int, metrics: Mapping[str, float], **values: Any) -> None:
        """Write the result with hashes of the run's files, then the status with other entries."""
        hashes = hash_finished_files(self.path)
        content = {"steps": steps, "metrics": dict(metrics), HASHES: hashes}
        write_json(self.path / RESULT_FILE, content)
        self.update_status(status="done", steps=steps, **values)

    def needs_evaluation(self, config: RunConfig) -> bool:
        """Return whether a finished run was evaluated with settings other than a config's."""
        entries = self.read_status()
        has_these_settings = entries.evaluation in (None, config.final_settings)
        return entries.status == "done" and not has_these_settings

    def evaluation_problem(self) -> str | None:
        """Return why a finished run can't be evaluated again, or None."""
        steps = self.read_status().steps
        if steps == 0:  # nothing was trained
            return None
        checkpoint = self.checkpoints / checkpoint_name(steps or 0)
        problem = checkpoint_problem(checkpoint)
        if problem is None:
            return None
        return (
            f"it can't be evaluated again with other settings, since {problem} in {checkpoint}; "
            f"`{command_of('evaluate')} run={self.path}` evaluates its final model"
        )

    def reopen(self) -> None:
        """Make a finished run pending. It is evaluated again when it is trained next."""
        # Without a start time the store takes it for a new run. The status changes last: after a
        # kill the run is still finished, and the next command reopens it.
        (self.path / PROVENANCE_FILE).unlink(missing_ok=True)
        (self.path / VIDEO_FILE).unlink(missing_ok=True)
        self.update_status(status="pending")

    @property
    def is_evaluated_again(self) -> bool:
        """Whether a finished run is being evaluated again."""
        return self.status != "done" and (self.path / RESULT_FILE).exists()

    def write_config(self, config: RunConfig) -> None:
        """Write the resolved config, and make the directory if it does not exist."""
        with self._writable():
            write_config(self.path, config)

    def reserve(self) -> None:
        """Reserve disk space for recording the run's end, until the run has ended."""
        with self._writable():
            (self.path / RESERVE).write_bytes(os.urandom(RESERVE_BYTES))  # what can't be compressed

    def begin(self) -> None:
        """Record that this process, which holds the supervisor lock, begins or resumes the run."""
        (self.path / TRACEBACK_FILE).unlink(missing_ok=True)
        self.update_status(
            status="running",
            error=None,
            killed=None,
            pid=os.getpid(),
            host=socket.gethostname(),
            started=time.time(),
        )

    def heartbeat(self, **values: Any) -> None:
        """Write the run's progress, for processes that monitor it."""
        # On a full disk, nothing depends on a heartbeat, and the next checkpoint will fail.
        with suppress(OSError):
            write_json(self.path / HEARTBEAT_FILE, {"time": time.time(), **values}, durable=False)

    def read_config(self) -> RunConfig:
        """Read the run's config; see `run_files.read_config`."""
        return read_config(self.path, self.output_dir)

    def check_links(self) -> None:
        """Raise UntrustedError for links that lead elsewhere, and for pipes and devices."""
        refuse_links(self.path.rglob("*"), self.path)

    def supervisor_lock(self) -> AbstractContextManager[None]:
        """Hold the lock of the process that is responsible for the run.

        Raises:
            RunLockedError: another process holds it.
            OutputDirectoryError: the directory cannot be made.
            UntrustedError: a symbolic link leads out of it.
        """
        return self._held(SUPERVISOR_LOCK, LOCK_PATIENCE_S)

    def training_lock(self) -> AbstractContextManager[None]:
        """Hold the lock of the process that trains the run; see `supervisor_lock`."""
        return self._held(TRAINING_LOCK, WORKER_PATIENCE_S)

    @contextmanager
    def _held(self, name: str, patience_s: float) -> Iterator[None]:
        with self._writable():
            self.path.mkdir(parents=True, exist_ok=True)
        try:
            lock = FileLock(self.path / name).acquire(timeout=patience_s)
        except Timeout:
            raise RunLockedError(
                f"another process is working on {self.path}; wait for it, or stop it first"
            ) from None
        with lock:
            self.check_links()
            yield

    @contextmanager
    def _writable(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputDirectoryError(
                f"output_dir: {self.path} cannot be written: {error.strerror}"
            ) from error

    def read_status(self) -> StatusEntries:
        """Return the entries of status.json; all are None if it is missing or damaged."""
        return read_entries(self.path / STATUS_FILE, StatusEntries) or StatusEntries()

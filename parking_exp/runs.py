"""Run directories: where a run lives, how far it is, and how to find it again.

    outputs/<experiment_name>/<cell>/seed=<n>/
        config.yaml  status.json  result.json  metrics.jsonl  episodes.csv  monitor.csv  progress.csv
        provenance.json  synced.json  checkpoints/  models/  evaluations/  tensorboard/  video.mp4  curves.png

The run directory is the truth; MLflow is its index.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from filelock import FileLock, Timeout
from omegaconf import OmegaConf

from parking_exp.config import RunConfig
from parking_exp.errors import OutputDirectoryError, RunLockedError, RunNotFoundError
from parking_exp.files import read_json, write_atomically, write_json
from parking_exp.validation import parse

Status = Literal["pending", "running", "done", "failed", "interrupted"]
STATUS_FILE, LOCK_FILE = "status.json", ".lock"


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
    """The directory of one run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def checkpoints(self) -> Path:
        """Directory of checkpoints."""
        return self.path / "checkpoints"

    @property
    def models(self) -> Path:
        """Directory of the best and the final model."""
        return self.path / "models"

    @property
    def status(self) -> Status:
        """How far the run is. A run that was killed still says `running`; its lock is free."""
        return self.read_status().get("status", "pending")

    @property
    def run_id(self) -> str | None:
        """MLflow run id, once the run has one."""
        return self.read_status().get("run_id")

    @property
    def tracking_uri(self) -> str | None:
        """Store that the run is tracked in."""
        return self.read_status().get("tracking_uri")

    @property
    def unsynced(self) -> str | None:
        """Why the store lacks something of the run; None as far as is known."""
        return self.read_status().get("unsynced")

    @property
    def under_way(self) -> bool:
        """Whether a process, be it this one, is working on the run now."""
        try:
            handle = os.open(self.path / LOCK_FILE, os.O_RDONLY)
        except FileNotFoundError:
            return False
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(handle)
        return False

    def update(self, **values: Any) -> None:
        """Change entries of status.json; None removes one."""
        # Its training, a sync and an evaluation may change different entries at once.
        with FileLock(self.path / ".status.lock"):
            changed = {**self.read_status(), **values}
            write_json(self.path / STATUS_FILE, {key: value for key, value in changed.items() if value is not None})

    def result(self) -> RunResult | None:
        """Return the stored result of a finished run, else None."""
        stored = read_json(self.path / "result.json")
        if not stored or self.status != "done":
            return None
        return RunResult(**{**stored, "run_id": self.run_id})  # the store may have been down until later

    def finish(self, result: RunResult) -> None:
        """Store the result; from here on the run is done."""
        write_json(self.path / "result.json", asdict(result))
        self.update(status="done")

    def create(self, config: RunConfig) -> None:
        """Make the directory and write the resolved config into it."""
        self.path.mkdir(parents=True, exist_ok=True)
        write_atomically(self.path / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(config.plain())))

    def config(self) -> RunConfig:
        """Read the run's config.

        Raises:
            ConfigError: it was written by another version of this package, and no longer fits.
        """
        return parse(RunConfig, OmegaConf.load(self.path / "config.yaml"))  # type: ignore[arg-type]

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes off the run. The lock ends with the process, however that ends.

        Raises:
            RunLockedError: another process holds it.
            OutputDirectoryError: the directory cannot be made.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputDirectoryError(f"output_dir: {self.path} cannot be made: {error.strerror}") from error
        # `under_way` of another process holds the lock for a moment.
        lock = FileLock(self.path / LOCK_FILE, timeout=0.2, poll_interval=0.02)
        try:
            lock.acquire()
        except Timeout:
            raise RunLockedError(f"another process is working on {self.path}; wait for it, or stop it first") from None
        try:
            yield
        finally:
            lock.release()

    def read_status(self) -> dict[str, Any]:
        """Return the entries of status.json."""
        return read_json(self.path / STATUS_FILE) or {}


def find_run(name: str, output_dir: Path, having: str) -> RunDirectory:
    """Find a run by its directory, its MLflow run id, or `latest`: the last worked on that has the file `having`.

    Raises:
        RunNotFoundError: there is none.
    """
    if (Path(name).expanduser() / STATUS_FILE).exists():
        return RunDirectory(Path(name).expanduser().absolute())
    files = sorted(output_dir.glob(f"*/*/*/{STATUS_FILE}"), key=lambda file: file.stat().st_mtime)
    if not files:
        raise RunNotFoundError(f"run={name}: there are no runs in {output_dir}; train one first, or set output_dir")
    if name == "latest":
        usable = [file for file in files if (file.parent / having).exists()]
        if not usable:
            raise RunNotFoundError(f"run=latest: none of the {len(files)} runs in {output_dir} has {having} yet")
        return RunDirectory(usable[-1].parent.absolute())
    for file in files:
        if read_json(file).get("run_id") == name:
            return RunDirectory(file.parent.absolute())
    raise RunNotFoundError(
        f"run={name}: no run directory and no MLflow run id of the {len(files)} runs in {output_dir}; "
        f"the latest is {files[-1].parent}"
    )

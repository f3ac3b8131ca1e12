"""Run directories: where a run lives, how far it is, and how to find it again.

    outputs/<experiment_name>/<cell>/seed=<n>/
        config.yaml  status.json  result.json  metrics.jsonl  episodes.csv  monitor.csv  progress.csv
        provenance.json  synced.json  checkpoints/  models/  evaluations/  tensorboard/  video.mp4  curves.png  log.txt

The run directory is the truth; MLflow is its index. Two locks keep processes apart: `.claim` belongs to whoever is
responsible for the run (its supervisor, or the process that trains it without one), `.lock` to the process that trains.
"""

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock, Timeout
from pydantic import TypeAdapter, ValidationError

from parking_exp.config.paths import absolute, directory_path, lies_inside, relative
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import check
from parking_exp.errors import (
    ConfigError,
    OutputDirectoryError,
    RunLockedError,
    RunNotFoundError,
    UntrustedError,
    did_you_mean,
    plural,
)
from parking_exp.runs.atomic import read_object, read_plain_yaml, write_atomically, write_json
from parking_exp.runs.provenance import typed_command
from parking_exp.runs.status_file import Status, StatusEntries, read_entries

STATUS_FILE, BEAT_FILE = "status.json", "beat.json"
MODELS = ("final.zip", "best.zip")
CLAIM, LOCK = ".claim", ".lock"
OUTPUT_DIR = "../../.."  # from a run directory
# A look at a lock takes it for a moment: who wants to have it tries again for this long.
LOCK_PATIENCE_S = 2.0
STALE_S = 3600.0
# Space that a run keeps while it trains, so that its end can be written down on a disk that is full by then.
RESERVE, RESERVE_BYTES = ".reserve", 64 * 1024
ENDS = ("done", "failed", "interrupted")
# A supervisor that is killed takes its worker with it; until it is gone, the next one waits.
WORKER_PATIENCE_S = 20.0


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
    def output_dir(self) -> Path:
        """The output directory that the run is in now: it may have been moved since the run was written."""
        return directory_path(self.path / OUTPUT_DIR)

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
        """Store that the run is tracked in; None where it is not tracked."""
        uri = self.read_status().get("tracking_uri")
        return absolute(uri, self.output_dir) if uri else None

    @property
    def unsynced(self) -> str | None:
        """Why the store lacks something of the run; None as far as is known."""
        return self.read_status().get("unsynced")

    @property
    def under_way(self) -> bool:
        """Whether a process, be it this one, is responsible for the run now, or works on it."""
        return any(_is_held(self.path / name) for name in (CLAIM, LOCK))

    @property
    def final_checkpoint(self) -> Path:
        """The checkpoint that a finished run's final model is from."""
        steps = self.read_status().get("steps")
        return self.checkpoints / (f"step={steps:010d}" if isinstance(steps, int) else "step=")

    @property
    def lacks_model(self) -> bool:
        """Whether the run is done, and its final or its best model is gone."""
        return not all((self.models / name).exists() for name in MODELS) and self.status == "done"

    @property
    def can_make_models(self) -> bool:
        """Whether the run is done, a model of its is gone, and the checkpoint is there that it can be made from."""
        # In this order, since a sweep asks this of every run.
        return self.checkpoints.exists() and self.lacks_model and self.final_checkpoint.exists()

    def update(self, **values: Any) -> None:
        """Change entries of status.json; None removes one."""
        if uri := values.get("tracking_uri"):
            values["tracking_uri"] = relative(uri, self.output_dir)
        if values.get("status") in ENDS:
            (self.path / RESERVE).unlink(missing_ok=True)
        self._update(values, durable=True)

    def result(self) -> RunResult | None:
        """Return the stored result of a finished run, else None, also where it is damaged."""
        stored = read_object(self.path / "result.json")
        if not stored or self.status != "done":
            return None
        # The store may have been down until later, and the directory moved.
        known = {**stored, "run_dir": str(self.path.absolute()), "run_id": self.run_id}
        with suppress(ValidationError):
            return TypeAdapter(RunResult).validate_python(known)
        return None

    def finish(self, result: RunResult, **values: Any) -> None:
        """Store the result, and entries of status.json; from here on the run is done."""
        write_json(self.path / "result.json", asdict(result))
        self.update(status="done", steps=result.steps, **values)

    def create(self, config: RunConfig) -> None:
        """Make the directory, write the resolved config into it, and reserve space for the run's end.

        Raises:
            OutputDirectoryError: it can't be written.
        """
        self._write_config(config, durable=True)
        self.reserve()

    def reserve(self) -> None:
        """Take up the space in which the run's end can be written, until that is done.

        Raises:
            OutputDirectoryError: there is not as much left.
        """
        path = self.path / RESERVE
        try:
            path.write_bytes(os.urandom(RESERVE_BYTES))  # what can't be compressed
        except OSError as error:
            path.unlink(missing_ok=True)
            raise OutputDirectoryError(f"output_dir: {self.path} cannot be written: {error.strerror}") from error

    def freeze(self, config: RunConfig, label: str, started: float | None, *, keep: bool = False) -> None:
        """Write down what is going to run, under which name in tables; nothing that is typed later changes it.

        A run that another process has taken up meanwhile is left as it is: one that is under way, or was begun at
        another time than `started`; with `keep`, also one that waits with a config. Nothing is waited for until it is
        on the disk: after a power cut, the sweep that is typed again writes it anew.

        Raises:
            OutputDirectoryError: the directory can't be written.
        """
        if self.under_way:
            return
        with suppress(RunLockedError), self._held(CLAIM, LOCK_PATIENCE_S):
            known = self.read_status()
            status = known.get("status")
            if status == "done" or known.get("started") != started:
                return
            if keep and status == "pending" and (self.path / "config.yaml").exists():
                return
            self._write_config(config, durable=False)
            entries = {"label": label, "total_timesteps": config.total_timesteps, "command": typed_command()}
            self._update({"status": "pending", "error": None, "killed": None, **entries}, durable=False)

    def beat(self, **values: Any) -> None:
        """Say how far the run is, for who looks at it from outside."""
        with suppress(OSError):  # a full disk: nothing hangs on a beat, and the next checkpoint will tell
            write_json(self.path / BEAT_FILE, {"time": time.time(), **values}, durable=False)

    def config(self) -> RunConfig:
        """Read the run's config, with the output directory and store of where the run is now.

        It is data: values were resolved when it was written, and nothing in it is resolved again.

        Raises:
            ConfigError: it can't be read, has an interpolation, or was written by another version of this package and
                no longer fits.
        """
        path = self.path / "config.yaml"
        try:
            stored = read_plain_yaml(path)
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path} can't be read: {str(error).splitlines()[0]}") from error
        if not isinstance(stored, dict):
            raise ConfigError(f"{path} can't be read: it is no config, but a {type(stored).__name__}")
        for key, value in _texts(stored):
            if "${" in value:
                raise ConfigError(f"{key}={value} in {path} is an interpolation; stored configs have values only")
        try:
            config = check(RunConfig, stored)
        except ConfigError as error:
            raise ConfigError(f"{path} does not fit this version of parking_exp: {error}") from error
        uri = config.tracking.uri and absolute(config.tracking.uri, self.output_dir)
        tracking = config.tracking.model_copy(update={"uri": uri})
        return config.model_copy(update={"output_dir": str(self.output_dir), "tracking": tracking})

    def check_links(self) -> None:
        """Refuse a run directory with links to files elsewhere, which would be written to or sent to a store.

        Raises:
            UntrustedError: it has a symbolic link that leads out of it.
        """
        for path in self.path.rglob("*"):
            if path.is_symlink() and not lies_inside(path, self.path):
                raise UntrustedError(f"{path} is a symbolic link that leads out of the run directory; remove it")

    @contextmanager
    def claimed(self) -> Iterator[None]:
        """Be the one who is responsible for the run. The claim ends with the process, however that ends.

        Raises:
            RunLockedError: another process is.
            OutputDirectoryError: the directory cannot be made.
            UntrustedError: a symbolic link leads out of it.
        """
        with self._held(CLAIM, LOCK_PATIENCE_S):
            yield

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Be the one who trains the run; raises what `claimed` does."""
        with self._held(LOCK, WORKER_PATIENCE_S):
            self._sweep_up()
            yield

    @contextmanager
    def _held(self, name: str, patience_s: float) -> Iterator[None]:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputDirectoryError(f"output_dir: {self.path} cannot be made: {error.strerror}") from error
        lock = FileLock(self.path / name, timeout=patience_s)
        try:
            lock.acquire()
        except Timeout:
            raise RunLockedError(f"another process is working on {self.path}; wait for it, or stop it first") from None
        try:
            self.check_links()
            yield
        finally:
            lock.release()

    def _update(self, values: dict[str, Any], durable: bool) -> None:
        # A training, its supervisor, a sync and an evaluation may change different entries at once.
        with FileLock(self.path / ".status.lock"):
            changed = {**self.read_status(), **values}
            kept = {key: value for key, value in changed.items() if value is not None}
            write_json(self.path / STATUS_FILE, kept, durable=durable)

    def _write_config(self, config: RunConfig, durable: bool) -> None:
        uri = config.tracking.uri and relative(config.tracking.uri, config.output_path)
        tracking = config.tracking.model_copy(update={"uri": uri})
        plain = config.model_copy(update={"output_dir": OUTPUT_DIR, "tracking": tracking}).plain()
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            write_atomically(self.path / "config.yaml", yaml.safe_dump(plain, sort_keys=False), durable=durable)
        except OSError as error:
            raise OutputDirectoryError(f"output_dir: {self.path} cannot be written: {error.strerror}") from error

    def _sweep_up(self) -> None:
        """Delete what a kill in the middle of a write has left, long ago: others may be writing now."""
        for stale in self.path.glob(".*.tmp"):
            with suppress(OSError):
                if stale.stat().st_mtime < time.time() - STALE_S:
                    stale.unlink()

    def read_status(self) -> dict[str, Any]:
        """Return the entries of status.json; one of the wrong type is none."""
        return read_entries(self.path / STATUS_FILE, StatusEntries)[0]


def _texts(node: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield every text in nested dicts and lists, keys included, with its dotted key."""
    if isinstance(node, str):
        yield key, node
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for name, value in children:
        path = f"{key}.{name}" if key else str(name)
        yield path, str(name)
        yield from _texts(value, path)


def _is_held(path: Path) -> bool:
    """Whether a process holds a lock file. A shared lock is tried, so that several may look at once."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:  # it was never locked
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False


def find_run(name: str, output_dir: Path, having: str) -> RunDirectory:
    """Find a run by its directory, its MLflow run id, or `latest`: the last worked on that has the file `having`.

    Raises:
        RunNotFoundError: there is none.
    """
    if (Path(name).expanduser() / STATUS_FILE).exists():
        return RunDirectory(directory_path(name))
    files = sorted(output_dir.glob(f"*/*/*/{STATUS_FILE}"), key=lambda file: file.stat().st_mtime)
    if not files:
        raise RunNotFoundError(f"run={name}: there are no runs in {output_dir}; train one first, or set output_dir")
    if name == "latest":
        usable = [file for file in files if (file.parent / having).exists()]
        if not usable:
            done = any(RunDirectory(file.parent).status == "done" for file in files)
            hint = "; where a run is done and it is gone, its training command typed again makes it" if done else ""
            there = plural(len(files), "run")
            raise RunNotFoundError(f"run=latest: of {there} in {output_dir}, none has {having} yet{hint}")
        return RunDirectory(usable[-1].parent.absolute())
    ids = {run_id: file.parent for file in files if (run_id := RunDirectory(file.parent).run_id)}
    if name in ids:
        return RunDirectory(ids[name].absolute())
    hint = did_you_mean(name, ["latest", *ids, *(str(file.parent) for file in files)])
    raise RunNotFoundError(
        f"run={name}: no run directory, and no MLflow run id of {plural(len(files), 'run')} in {output_dir}"
        + (hint or f"; the latest is {files[-1].parent}")
    )

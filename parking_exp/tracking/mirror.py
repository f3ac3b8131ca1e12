"""Sync one run directory to an MLflow store; the directory is the source of truth.

`sync` needs nothing but a run directory, in any state that a kill can leave it in, and does what is missing: after each
checkpoint, at the end, and later for a run whose store was down or that was killed.

Metrics are sent as soon as they are final: up to the last checkpoint, and all of them when the run is done. A run that
was cut off goes on from that checkpoint and logs everything after it again. So the store's latest points are always
among those of the run directory. Where they are not, the store's run diverges and is replaced: the directory was
deleted and the run trained afresh, or the last checkpoint was corrupt and the one before it was taken. A run that the
store has whole is never replaced, so that somebody who deletes logs of a finished run does not lose them in the store.

`synced.json` says what the store has: which status and error, and size and time of each file that was sent. It is
written after the fact, so that a kill makes a file be sent twice, never be forgotten.
"""

import traceback
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from parking_exp.config.cell_labels import settings_of
from parking_exp.config.paths import absolute, database, relative, relative_path
from parking_exp.config.schema import RunConfig
from parking_exp.runs.atomic_files import fingerprint, read_object, write_json
from parking_exp.runs.directory import RunDirectory, Status
from parking_exp.runs.metric_logs import has_whole_logs, read_metrics
from parking_exp.runs.run_provenance import PROVENANCE_FILE, read_provenance
from parking_exp.tracking import artifacts
from parking_exp.tracking.failures import is_store_failure, reason
from parking_exp.tracking.store import Store
from parking_exp.tracking.tags import NOTE, run_note

if TYPE_CHECKING:
    from mlflow.entities import Metric, Run

SYNCED_FILE, TRACEBACK_FILE = "synced.json", "sync_traceback.txt"
# MLflow cuts or refuses longer values; the whole config is an artifact besides.
LONGEST_PARAM = 6000
LONGEST_ERROR = 500
WAIT_S = 120  # for another process that syncs the same run
MLFLOW_STATUS = {
    "running": "RUNNING",
    "done": "FINISHED",
    "failed": "FAILED",
    "interrupted": "KILLED",
    "pruned": "KILLED",
}


def sync(directory: RunDirectory, uri: str) -> None:
    """Make a store agree with a run directory. Done again, it changes nothing.

    Raises:
        ConfigError: the run's config can't be read.
        DamagedFileError: the log of metrics can't be read.
        UntrustedError: a symbolic link leads out of the run directory.
        StoreError: the store can't take the run as it is.
        Exception: the store can't be reached, or does not take it all; `failures.is_store_failure` tells which.
    """
    uri = absolute(uri)
    config = directory.config()
    directory.check_links()
    with FileLock(directory.path / ".sync.lock", timeout=WAIT_S):
        status, tags = present_status(directory), _tags(directory, config, uri)
        store = Store(uri, directory.output_dir)
        known = store.find(directory.run_id, config.experiment_name, tags)
        points = _final_metrics(directory, status)
        if known is not None and _diverges(known, directory):
            store.delete(known)
            known = None
        run = _run(store, known, directory, config, tags)
        sent = _Sent(directory, uri, run.info.run_id)
        if sent.status != status:  # from here on a kill leaves a run that is not in step
            sent.status = None
            sent.write()
        params = {key: value[:LONGEST_PARAM] for key, value in flatten(config.plain()).items()}
        if run.data.tags.get(NOTE, sent.note) == sent.note:  # else a user has written another one
            sent.note = tags[NOTE] = run_note(directory, config)
        store.log(run, params, tags)
        sent.error = tags["error"]
        latest = _latest_points(run)
        store.log_metrics(run, [point for point in points if point.step > latest.get(point.key, (-1, 0))[0]])
        try:
            artifacts.send(store, run, directory, status == "running", sent.files)
        finally:
            sent.write()
        # Last, so that a run that is done in the store has everything there.
        store.set_status(run, status, MLFLOW_STATUS[status], None if status == "running" else _end_ms(directory))
        sent.status = status
        sent.write()


def try_sync(directory: RunDirectory, uri: str) -> str | None:
    """Sync as far as the store allows, and return what is in the way, or None.

    The reason is noted in status.json as `unsynced` until a later attempt succeeds. An error of this package stops
    nothing either, since the run directory has everything; its traceback is kept, and named.
    """
    problem = None
    try:
        sync(directory, uri)
    except Exception as error:
        problem = reason(error) if is_store_failure(error) else _keep_traceback(directory, error)
    with suppress(OSError):  # on a full disk
        if problem is None:
            (directory.path / TRACEBACK_FILE).unlink(missing_ok=True)
        if directory.unsynced != problem:
            directory.update(unsynced=problem)
    return problem


def recorded_in_step(directory: RunDirectory) -> bool:
    """Whether a store had all that it is to have of a run when it was synced last, as its small files tell."""
    status, sent = directory.read_status(), read_object(directory.path / SYNCED_FILE)
    files = sent.get("files")
    return (
        not status.get("unsynced")
        and sent.get("uri") == status.get("tracking_uri")
        and sent.get("run_id") == status.get("run_id")
        and sent.get("status") == present_status(directory)
        and sent.get("error", "") == _error(directory)
        and isinstance(files, dict)
        and all(files.get(name) == fingerprint(file) for name, file in artifacts.evaluations(directory))
    )


def present_status(directory: RunDirectory) -> Status:
    """Return a run's status for the store, where one that was killed or is pending is `interrupted`."""
    status = directory.status
    if status == "pending" or (status == "running" and not directory.under_way):
        return "interrupted"
    return status


def flatten(config: Mapping[str, Any]) -> dict[str, str]:
    """Return nested mappings as one level with dotted keys; lists stay whole."""
    return {key: str(value) for key, value in settings_of(config).items()}


class _Sent:
    """`synced.json`: what the store has of a run, as far as its directory knows."""

    def __init__(self, directory: RunDirectory, uri: str, run_id: str) -> None:
        self._path = directory.path / SYNCED_FILE
        self._written = read_object(self._path)
        self.uri, self.run_id = relative(uri, directory.output_dir), run_id
        same = self._written.get("uri") == self.uri and self._written.get("run_id") == run_id
        known = self._written if same else {}
        self.status: str | None = known.get("status")
        self.error: str = known.get("error", "")
        self.note: str | None = known.get("note")
        files = known.get("files")
        self.files: dict[str, list[int]] = dict(files) if isinstance(files, dict) else {}

    def write(self) -> None:
        """Write it down, if it has changed."""
        value = {
            "uri": self.uri,
            "run_id": self.run_id,
            "status": self.status,
            "error": self.error,
            "note": self.note,
            "files": self.files,
        }
        if value != self._written:
            write_json(self._path, value)
            self._written = {**value, "files": dict(self.files)}


def _run(store: Store, run: "Run | None", directory: RunDirectory, config: RunConfig, tags: dict[str, str]) -> "Run":
    """Return the store's run, the one that was found or a new one, and write its id down."""
    if run is None:
        run = store.create(config, {**tags, "status": "running"}, read_provenance(directory.path / PROVENANCE_FILE)[0])
    if directory.run_id != run.info.run_id or directory.tracking_uri != store.uri:
        directory.update(run_id=run.info.run_id, tracking_uri=store.uri)
    return run


def _tags(directory: RunDirectory, config: RunConfig, uri: str) -> dict[str, str]:
    path, status = database(uri), directory.read_status()
    searched: dict[str, str] = {name: str(status[name]) for name in ("search", "trial") if name in status}
    run_dir = relative_path(directory.path, path.parent) if path else str(directory.path.absolute())
    return {
        **read_provenance(directory.path / PROVENANCE_FILE)[1],
        "experiment": config.experiment_name,
        "cell": config.cell,
        "seed": str(config.seed),
        "run_key": config.run_key,
        "run_dir": run_dir,
        **searched,
        "error": _error(directory),
    }


def _error(directory: RunDirectory) -> str:
    """Return why a run has failed, in one line; nothing for one that has not, or that goes on."""
    status = directory.read_status()
    words = " ".join(str(status.get("error", "")).split()) if status.get("status") == "failed" else ""
    return words if len(words) <= LONGEST_ERROR else f"{words[: LONGEST_ERROR - 3]}..."


def _final_metrics(directory: RunDirectory, status: Status) -> list["Metric"]:
    """Return all points that no resumed run is going to log again."""
    from mlflow.entities import Metric

    folder = directory.path if status == "done" else _last_checkpoint(directory)
    return [
        Metric(key, value, record["time_ms"], record["step"])
        for record in (read_metrics(folder / "metrics.jsonl") if folder else ())
        for key, value in record["metrics"].items()
    ]


def _last_checkpoint(directory: RunDirectory) -> Path | None:
    """Return the newest checkpoint whose logs are whole."""
    folders = artifacts.checkpoint_folders(directory)
    return next((folder for folder in reversed(folders) if has_whole_logs(folder)), None)


def _latest_points(run: "Run") -> dict[str, tuple[int, int]]:
    """Return step and time of the last point that the store has of each metric."""
    return {metric.key: (metric.step, metric.timestamp) for metric in run.data.to_proto().metrics}


def _diverges(run: "Run", directory: RunDirectory) -> bool:
    """Return whether the store's latest point of a metric is not in the run directory; other metrics don't count."""
    if run.data.tags.get("status") == "done" and run.info.run_id == directory.run_id:
        return False
    ours: dict[str, set[tuple[int, int]]] = {}
    for record in read_metrics(directory.path / "metrics.jsonl"):
        for key in record["metrics"]:
            ours.setdefault(key, set()).add((record["step"], record["time_ms"]))
    return any(key in ours and latest not in ours[key] for key, latest in _latest_points(run).items())


def _end_ms(directory: RunDirectory) -> int:
    """Return when the run last wrote something: it may have ended long before it is synced."""
    names = ("config.yaml", "metrics.jsonl", "traceback.txt", "result.json")
    times = [file.stat().st_mtime_ns for name in names if (file := directory.path / name).exists()]
    return max(times) // 1_000_000


def _keep_traceback(directory: RunDirectory, error: Exception) -> str:
    path = directory.path / TRACEBACK_FILE
    path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
    return f"an error of parking_exp: {type(error).__name__}: {error}; its traceback is in {path}; please report it"

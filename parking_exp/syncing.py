"""Making a store agree with run directories: these are the truth, the store is their index.

`sync` needs nothing but a run directory, in any state that a kill can leave it in, and does what is missing: after each
checkpoint, at the end, and later for a run whose store was down or that was killed.

Metrics are sent as soon as they are final: up to the last checkpoint, and all of them when the run is done. A run that
was cut off goes on from that checkpoint and logs everything after it again. So the store's latest points are always
among those of the run directory. Where they are not, the store's run has another past and is replaced: the directory
was deleted and the run trained afresh, or the last checkpoint was corrupt and the one before it was taken.

`synced.json` says what the store has: which status and error, and size and time of each file that was sent. It is
written after the fact, so that a kill makes a file be sent twice, never be forgotten.
"""

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from parking_exp import artifacts
from parking_exp.config import RunConfig
from parking_exp.files import fingerprint, read_object, write_json
from parking_exp.provenance import PROVENANCE_FILE
from parking_exp.runs import RunDirectory, Status
from parking_exp.store import Store, absolute, connect, database, reason

if TYPE_CHECKING:
    from mlflow.entities import Metric, Run

SYNCED_FILE = "synced.json"
# MLflow cuts or refuses longer values; the whole config is an artifact besides.
LONGEST_PARAM = 6000
LONGEST_ERROR = 500
WAIT_S = 120  # for another process that syncs the same run
MLFLOW_STATUS = {"running": "RUNNING", "done": "FINISHED", "failed": "FAILED", "interrupted": "KILLED"}


def sync(directory: RunDirectory, uri: str | None = None) -> None:
    """Make a store agree with a run directory. Done again, it changes nothing.

    Args:
        directory: of a run that is tracked; for one that is not, nothing is done.
        uri: the store; None for the one that the run was tracked in.

    Raises:
        ConfigError: the run was made by another version of this package.
        Exception: the store can't be reached or does not take it all; `store.reason` makes a sentence of it.
    """
    if (stored_at := uri or directory.tracking_uri) is None:
        return
    uri = absolute(stored_at)
    config = directory.config()
    with FileLock(directory.path / ".sync.lock", timeout=WAIT_S):
        status = present_status(directory)
        store, points = Store(uri), _final_metrics(directory, status)
        run = _run(store, directory, config, points)
        sent = _Sent(directory, uri, run.info.run_id)
        if sent.status != status:  # from here on a kill leaves a run that is not in step
            sent.status = None
            sent.write()
        params = {key: value[:LONGEST_PARAM] for key, value in flatten(config.plain()).items()}
        tags = _tags(directory, config)
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


def try_sync(directory: RunDirectory, uri: str | None = None) -> str | None:
    """Sync as far as the store allows, and return what is in the way, or None.

    The reason is noted in status.json as `unsynced` until a later attempt succeeds.
    """
    problem = None
    try:
        sync(directory, uri)
    except Exception as error:  # whatever it is, the run directory has everything, and a training has to go on
        problem = reason(error)
    if directory.unsynced != problem:
        with suppress(OSError):  # on a full disk
            directory.update(unsynced=problem)
    return problem


def sync_all(directories: Iterable[RunDirectory]) -> Iterator[tuple[RunDirectory, str | None]]:
    """Sync every run that is not in step with its store and that no process is working on.

    Runs that are in step are told from small files, without a connection.

    Yields:
        Each run that was not in step, and what kept it from being so now, or None.
    """
    down: dict[str, str] = {}
    # All are looked at first: where a store was lost, the first run to be sent makes it again.
    behind = [directory for directory in directories if not in_step(directory)]
    for directory in behind:
        if directory.under_way:
            continue
        uri = directory.tracking_uri or ""
        problem = down.get(uri) or try_sync(directory)
        if problem and uri not in down and (cause := _unreachable(uri)):
            down[uri] = cause  # the next thousand runs need not knock
        yield directory, problem


def in_step(directory: RunDirectory) -> bool:
    """Whether the store has all that it is to have of a run (or the run is not tracked)."""
    status = directory.read_status()
    uri, sent = status.get("tracking_uri"), read_object(directory.path / SYNCED_FILE)
    if uri is None:
        return True
    path = database(uri)
    return (
        not status.get("unsynced")
        and sent.get("uri") == uri
        and sent.get("status") == present_status(directory)
        and sent.get("error", "") == _error(directory)
        and (path is None or path.exists())
        and all(sent["files"].get(name) == fingerprint(file) for name, file in artifacts.evaluations(directory))
    )


def present_status(directory: RunDirectory) -> Status:
    """Return a run's status; one that was killed is `interrupted`."""
    status = directory.status
    return "interrupted" if status == "running" and not directory.under_way else status


def flatten(config: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return nested mappings as one level with dotted keys; lists stay whole."""
    flat: dict[str, str] = {}
    for key, value in config.items():
        name = f"{prefix}{key}"
        flat |= flatten(value, f"{name}.") if isinstance(value, Mapping) and value else {name: str(value)}
    return flat


class _Sent:
    """What the store has of a run, as far as this run directory knows."""

    def __init__(self, directory: RunDirectory, uri: str, run_id: str) -> None:
        self._path = directory.path / SYNCED_FILE
        self._written = read_object(self._path)
        self.uri, self.run_id = uri, run_id
        same = self._written.get("uri") == uri and self._written.get("run_id") == run_id
        self.status: str | None = self._written.get("status") if same else None
        self.error: str = self._written.get("error", "") if same else ""
        self.files: dict[str, list[int]] = dict(self._written["files"]) if same else {}

    def write(self) -> None:
        """Write it down, if it has changed."""
        value = {
            "uri": self.uri,
            "run_id": self.run_id,
            "status": self.status,
            "error": self.error,
            "files": self.files,
        }
        if value != self._written:
            write_json(self._path, value)
            self._written = {**value, "files": dict(self.files)}


def _run(store: Store, directory: RunDirectory, config: RunConfig, points: list["Metric"]) -> "Run":
    """Return the store's run, found or created, and write its id down."""
    tags, known = _tags(directory, config), directory.run_id
    run = store.find(known, config.experiment_name, tags)
    if run is not None and _another_past(run, points):
        store.delete(run)
        run = None
    if run is None:
        start_ms = read_object(directory.path / PROVENANCE_FILE).get("started_ms")
        run = store.create(config, {**tags, "status": "running"}, start_ms)
    if known != run.info.run_id or directory.tracking_uri != store.uri:
        directory.update(run_id=run.info.run_id, tracking_uri=store.uri)
    return run


def _tags(directory: RunDirectory, config: RunConfig) -> dict[str, str]:
    return {
        "experiment": config.experiment_name,
        "cell": config.cell,
        "seed": str(config.seed),
        "run_key": config.run_key,
        "run_dir": str(directory.path.absolute()),
        "error": _error(directory),
        **read_object(directory.path / PROVENANCE_FILE).get("tags", {}),
    }


def _error(directory: RunDirectory) -> str:
    """Return why a run has failed, in one line; nothing for one that has not, or that goes on."""
    status = directory.read_status()
    words = " ".join(str(status.get("error", "")).split()) if status.get("status") == "failed" else ""
    return words if len(words) <= LONGEST_ERROR else f"{words[: LONGEST_ERROR - 3]}..."


def _final_metrics(directory: RunDirectory, status: Status) -> list["Metric"]:
    """Return all points that no resumed run is going to log again."""
    from mlflow.entities import Metric

    path = directory.path / "metrics.jsonl"
    if not path.exists():
        return []
    size = None if status == "done" else _size_at_checkpoint(directory, path.name)
    with path.open("rb") as file:
        records = [json.loads(line) for line in file.read(size).splitlines()]
    return [
        Metric(key, value, record["time_ms"], record["step"])
        for record in records
        for key, value in record["metrics"].items()
    ]


def _size_at_checkpoint(directory: RunDirectory, name: str) -> int:
    """Return how long a log was at the last checkpoint. One that can't be read is not what a resumed run takes."""
    for folder in reversed(artifacts.checkpoint_folders(directory)):
        if sizes := read_object(folder / artifacts.STATE).get("progress", {}).get("log_sizes"):
            return sizes.get(name, 0)
    return 0


def _latest_points(run: "Run") -> dict[str, tuple[int, int]]:
    """Return step and time of the last point that the store has of each metric."""
    return {metric.key: (metric.step, metric.timestamp) for metric in run.data.to_proto().metrics}


def _another_past(run: "Run", points: list["Metric"]) -> bool:
    """Whether the store's latest point of a metric is none of the run directory's. Metrics of others don't count."""
    ours: dict[str, set[tuple[int, int]]] = {}
    for point in points:
        ours.setdefault(point.key, set()).add((point.step, point.timestamp))
    return any(key in ours and latest not in ours[key] for key, latest in _latest_points(run).items())


def _end_ms(directory: RunDirectory) -> int:
    """Return when the run last wrote something: it may have ended long before it is synced."""
    names = ("config.yaml", "metrics.jsonl", "traceback.txt", "result.json")
    times = [file.stat().st_mtime_ns for name in names if (file := directory.path / name).exists()]
    return max(times) // 1_000_000


def _unreachable(uri: str) -> str | None:
    try:
        connect(uri)
    except Exception as error:
        return reason(error)
    return None

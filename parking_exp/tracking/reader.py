"""Read-only bulk access to a store: runs, histories of metrics, artifacts.

From a database, rows are selected as plain columns through MLflow's table models, since its client makes several
objects of each row. Of 1,000 runs with 96,000 points, CPU time on one machine: runs 1.4 s, by `search_runs` in pages
of 1,000 9.5 s; histories of 8 metrics 0.9 s, by `get_metric_history` 0.08 s a run, so 78 s in all. An MLflow server is
asked for the histories of a hundred runs at once, by a route that its own pictures take and its client lacks; where
there is no such route, run by run.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from parking_exp.config.credentials import with_password
from parking_exp.config.paths import absolute, database, lies_inside, local_folder
from parking_exp.errors import ParkingError, ResultsError
from parking_exp.tracking.client import connect
from parking_exp.tracking.failures import is_store_failure, reason
from parking_exp.tracking.store import own_directory

Point = tuple[str, int, int, float]
"""Run id, step, time in ms, value."""

RUNS_A_PAGE = 1000
RUNS_A_REQUEST, POINTS_A_REQUEST = 100, 25_000  # limits of MLflow's server
AT_ONCE = 16  # requests to a server
HISTORIES = "/ajax-api/2.0/mlflow/metrics/get-history-bulk"


@dataclass(frozen=True)
class StoredRun:
    """A run in a store, without the histories of its metrics: `metrics` has the last values."""

    run_id: str
    name: str
    experiment_id: str
    start_ms: int | None
    end_ms: int | None
    artifact_uri: str
    tags: dict[str, str] = field(default_factory=dict)
    params: dict[str, str] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)


class Reader:
    """A read-only connection to a store that exists.

    Args:
        uri: the store.
        artifacts_in: the folder that artifacts have to lie in, since a store may come from elsewhere; None: anywhere.

    Raises:
        ResultsError: there is none, or it does not answer.
    """

    def __init__(self, uri: str, artifacts_in: Path | None = None) -> None:
        self.uri, self._artifacts_in = absolute(uri), artifacts_in
        path = database(self.uri)
        if path is not None and not path.is_file():
            raise ResultsError(f"there is no store {path}; train something first, or name another output_dir or store")
        if path is None and Path(uri).is_file():
            raise ResultsError(f"uri={uri} is a file and no URI; type sqlite:///{uri}")
        with self._asked():
            if artifacts_in is not None:
                own_directory(self.uri, artifacts_in)
            self._client = connect(self.uri)
            self._store = self._client._tracking_client.store
            self._database = self._store.ManagedSessionMaker if hasattr(self._store, "ManagedSessionMaker") else None

    def run_dir(self, tag: str | None) -> str | None:
        """Return the run directory that a run's tag means: relative ones lie beside an embedded store."""
        path = database(self.uri)
        return str(path.parent / tag) if path and tag else tag

    def experiments(self) -> dict[str, str]:
        """Return the ids of all experiments that are not deleted, by name."""
        with self._asked():
            found = self._pages(lambda token: self._client.search_experiments(page_token=token))
            return {experiment.name: experiment.experiment_id for experiment in found}

    def runs(self, experiment_ids: Sequence[str]) -> list[StoredRun]:
        """Return all runs of some experiments that are not deleted, the first started first."""
        with self._asked():
            if self._database is not None:
                return _runs_of_database(self._database, experiment_ids)
            found = self._pages(lambda token: self._client.search_runs(experiment_ids, "", 1, RUNS_A_PAGE, None, token))
            runs = [
                StoredRun(
                    info.run_id, info.run_name, info.experiment_id, info.start_time, info.end_time, info.artifact_uri,
                    data.tags, data.params, data.metrics,
                )
                for info, data in ((run.info, run.data) for run in found)
            ]  # fmt: skip
            return sorted(runs, key=lambda run: run.start_ms or 0)

    def histories(self, run_ids: Sequence[str], keys: Sequence[str]) -> dict[str, list[Point]]:
        """Return all points of some metrics, by key; of one run in the order in which they were logged."""
        with self._asked():
            if self._database is not None:
                return _histories_of_database(self._database, run_ids, keys)
            with ThreadPoolExecutor(AT_ONCE) as pool:
                requests = [(key, chunk) for key in keys for chunk in chunks(run_ids, RUNS_A_REQUEST)]
                answers = pool.map(lambda request: self._from_server(*request), requests)
                found: dict[str, list[Point]] = {key: [] for key in keys}
                for (key, _), points in zip(requests, answers, strict=True):
                    found[key] += points
                return found

    def artifact(self, folder_uri: str, name: str) -> bytes | None:
        """Return the content of a run's artifact, None where it has none of that name.

        Raises:
            Exception: it is there and can't be had; `failures.reason` makes a sentence of it.
        """
        if not folder_uri:
            raise ResultsError("the store does not say where its artifacts are")
        folder = local_folder(folder_uri)
        within = self._artifacts_in
        if within is not None and (folder is None or not lies_inside(folder / name, within)):
            raise ResultsError(f"it lies outside of {within}; tracking.uri={self.uri} reads it there, too")
        if folder is not None:
            try:
                return (folder / name).read_bytes()
            except FileNotFoundError:
                return None
        from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

        place = get_artifact_repository(folder_uri, tracking_uri=with_password(self.uri))
        with TemporaryDirectory() as temporary:
            try:
                return Path(place.download_artifacts(name, temporary)).read_bytes()
            except Exception:
                if any(item.path == name for item in place.list_artifacts()):
                    raise
                return None

    def artifacts(self, folder_uris: Iterable[str], name: str) -> Iterator[bytes | Exception | None]:
        """Yield what `artifact` returns or raises for each of many runs; from a server several at a time."""
        uris = list(folder_uris)

        def one(uri: str) -> bytes | Exception | None:
            try:
                return self.artifact(uri, name)
            except Exception as error:
                if not is_store_failure(error):
                    raise
                return error  # the caller says it

        if all(local_folder(uri) is not None for uri in uris):
            yield from map(one, uris)
            return
        with ThreadPoolExecutor(AT_ONCE) as pool:
            yield from pool.map(one, uris)

    def _from_server(self, key: str, run_ids: Sequence[str]) -> list[Point]:
        from mlflow.exceptions import MlflowException
        from mlflow.utils.rest_utils import http_request_safe

        parameters = {"run_id": list(run_ids), "metric_key": key, "max_results": POINTS_A_REQUEST}
        # Another kind of server has no such route, or another answer; if it is down, the next request says so.
        with suppress(MlflowException, OSError, ValueError, KeyError, TypeError):
            answer = http_request_safe(self._store.get_host_creds(), HISTORIES, "GET", params=parameters).json()
            points = [(p["run_id"], int(p["step"]), int(p["timestamp"]), float(p["value"])) for p in answer["metrics"]]
            if len(points) < POINTS_A_REQUEST:
                return points
        return [
            (run_id, point.step, point.timestamp, point.value)
            for run_id in run_ids
            for point in self._client.get_metric_history(run_id, key)
        ]

    @staticmethod
    def _pages(page: Callable[[str | None], Any]) -> Iterator[Any]:
        token: str | None = None
        while True:
            found = page(token)
            yield from found
            if not (token := found.token):
                return

    @contextmanager
    def _asked(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            if isinstance(error, ParkingError) or not is_store_failure(error):
                raise
            raise ResultsError(f"the store {self.uri} can't be read: {reason(error)}") from error


def chunks(items: Sequence[str], size: int) -> Iterator[Sequence[str]]:
    """Yield a sequence in pieces of at most some size."""
    for start in range(0, len(items), size):
        yield items[start : start + size]


def _runs_of_database(session_maker: Any, experiment_ids: Sequence[str]) -> list[StoredRun]:
    from mlflow.store.tracking.dbmodels.models import SqlLatestMetric, SqlParam, SqlRun, SqlTag
    from sqlalchemy import select

    columns = (
        SqlRun.run_uuid, SqlRun.name, SqlRun.experiment_id, SqlRun.start_time, SqlRun.end_time, SqlRun.artifact_uri
    )  # fmt: skip
    there = SqlRun.experiment_id.in_([int(name) for name in experiment_ids]), SqlRun.lifecycle_stage == "active"
    with session_maker() as session:
        rows = session.execute(select(*columns).where(*there).order_by(SqlRun.start_time))
        runs = {row[0]: StoredRun(row[0], row[1] or "", str(row[2]), *row[3:]) for row in rows}
        for chunk in chunks(list(runs), RUNS_A_PAGE):
            for model, name in ((SqlTag, "tags"), (SqlParam, "params")):
                entries = select(model.run_uuid, model.key, model.value).where(model.run_uuid.in_(chunk))
                for run_id, key, value in session.execute(entries):
                    getattr(runs[run_id], name)[key] = value
            metric = SqlLatestMetric
            latest = select(metric.run_uuid, metric.key, metric.value, metric.is_nan).where(metric.run_uuid.in_(chunk))
            for run_id, key, value, is_nan in session.execute(latest):
                runs[run_id].metrics[key] = math.nan if is_nan else value
    return list(runs.values())


def _histories_of_database(session_maker: Any, run_ids: Sequence[str], keys: Sequence[str]) -> dict[str, list[Point]]:
    from mlflow.store.tracking.dbmodels.models import SqlMetric
    from sqlalchemy import select

    columns = (
        SqlMetric.key,
        SqlMetric.run_uuid,
        SqlMetric.step,
        SqlMetric.timestamp,
        SqlMetric.value,
        SqlMetric.is_nan,
    )
    found: dict[str, list[Point]] = {key: [] for key in keys}
    with session_maker() as session:
        for chunk in chunks(run_ids, RUNS_A_PAGE):
            wanted = select(*columns).where(SqlMetric.run_uuid.in_(chunk), SqlMetric.key.in_(keys))
            for key, run_id, step, time_ms, value, is_nan in session.execute(wanted.order_by(SqlMetric.timestamp)):
                found[key].append((run_id, step, time_ms, math.nan if is_nan else value))
    return found

"""Read and write an MLflow store through its public client; many processes may write at a time."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from parking_exp.config.paths import ARTIFACTS, absolute, database, lies_inside, local_folder
from parking_exp.config.schema import RunConfig
from parking_exp.errors import StoreError
from parking_exp.runs.atomic_files import replacing
from parking_exp.tracking.client import connect, write_lock
from parking_exp.tracking.relocation import OUTPUT_DIR_TAG
from parking_exp.tracking.tags import experiment_tags

if TYPE_CHECKING:
    from mlflow.entities import Metric, Run

METRICS_A_BATCH, PARAMS_A_BATCH = 1000, 100  # MLflow's own limits
RUNS_A_PAGE = 10_000  # one request for most stores; MLflow's limit is 50,000
DOWNLOADS_AT_ONCE = 16


class Store:
    """A connection to a store. Only what writes takes its lock.

    Args:
        uri: the store.
        output_dir: an output directory whose own store this may be. Such a store may come from elsewhere with the
            directory, so it reads and writes artifacts below it only. None: artifacts may lie anywhere.

    Raises:
        StoreError: the store's file is a link that leads out of the output directory.
        Exception: what `client.connect` raises.
    """

    def __init__(self, uri: str, output_dir: Path | None) -> None:
        self.uri = absolute(uri)
        self._database = path = database(self.uri)
        self._own_directory = output_dir if path and output_dir and path.is_relative_to(output_dir) else None
        if path and self._own_directory and not lies_inside(path, self._own_directory):
            raise StoreError(
                f"{path} is a symbolic link that leads out of {self._own_directory}; name the store with tracking.uri="
            )
        self.client = connect(self.uri)
        self._lock = write_lock(self.uri)

    def experiments(self) -> dict[str, str]:
        """Return the ids of all experiments that are not deleted, by name."""
        found, token = dict[str, str](), None
        while True:
            page = self.client.search_experiments(page_token=token)
            found |= {experiment.name: experiment.experiment_id for experiment in page}
            if not (token := page.token):
                return found

    def runs(self, experiment_ids: Sequence[str], condition: str = "", *, deleted: bool = False) -> "list[Run]":
        """Return all runs of some experiments that fulfil a condition, the first started first.

        Args:
            experiment_ids: of the experiments; without any there are no runs.
            condition: in MLflow's language of filters.
            deleted: whether runs that a user has deleted are among them.
        """
        from mlflow.entities import ViewType

        view, found, token = ViewType.ALL if deleted else ViewType.ACTIVE_ONLY, list["Run"](), None
        while experiment_ids:
            page = self.client.search_runs(list(experiment_ids), condition, view, RUNS_A_PAGE, page_token=token)
            found += page
            if not (token := page.token):
                break
        return sorted(found, key=lambda run: run.info.start_time or 0)

    def run_dir(self, run: "Run") -> Path | None:
        """Return the run directory that a run's tag means: a relative one lies beside an embedded store."""
        tag = run.data.tags.get("run_dir")
        if not tag or not tag.isprintable():
            return None
        return (self._database.parent if self._database else Path()) / tag

    def experiment_id(self, config: RunConfig) -> str:
        """Return the id of a run's experiment, made by one process of many."""
        from mlflow.exceptions import MlflowException

        name, location, tags = config.experiment_name, None, experiment_tags(config.experiment_name)
        # A tracking server has its own place for artifacts; a database would put them into the current directory.
        if not self.uri.startswith(("http", "databricks")):
            location = (config.output_path / ARTIFACTS / name).as_uri()
        if self._own_directory:
            tags[OUTPUT_DIR_TAG] = str(self._own_directory)
        with self._lock:
            experiment = self.client.get_experiment_by_name(name)
            if experiment is None:
                try:
                    return self.client.create_experiment(name, location, tags)
                except MlflowException:  # without a lock of ours another process may have been first
                    experiment = self.client.get_experiment_by_name(name)
                    if experiment is None:
                        raise
        self._refuse_elsewhere(experiment.artifact_location, "")
        return experiment.experiment_id

    def create_run(self, experiment_id: str, name: str, start_ms: int | None, tags: Mapping[str, str]) -> "Run":
        """Create a run."""
        with self._lock:
            return self.client.create_run(experiment_id, start_time=start_ms, tags=dict(tags), run_name=name)

    def delete_run(self, run: "Run") -> None:
        """Delete a run, as MLflow's UI does: it can be restored there."""
        with self._lock:
            self.client.delete_run(run.info.run_id)

    def log(
        self, run: "Run", params: Mapping[str, str], tags: Mapping[str, str], metrics: Sequence["Metric"] = ()
    ) -> None:
        """Log parameters that the run does not have yet (they can't be changed), tags that differ, and metrics.

        A batch of metrics is stored as a whole or not at all.
        """
        from mlflow.entities import Param, RunTag

        missing = [Param(key, value) for key, value in params.items() if key not in run.data.params]
        changed = [RunTag(key, value) for key, value in tags.items() if run.data.tags.get(key) != value]
        batches: list[dict[str, Any]] = [{"tags": changed}] if changed else []
        batches += [{"params": batch} for batch in _batches(missing, PARAMS_A_BATCH)]
        batches += [{"metrics": batch} for batch in _batches(metrics, METRICS_A_BATCH)]
        for batch in batches:
            with self._lock:
                self.client.log_batch(run.info.run_id, **batch)

    def set_status(self, run: "Run", status: str, end_ms: int | None) -> None:
        """Set MLflow's own status of a run; `end_ms` is for one that does not go on."""
        with self._lock:
            if end_ms is None:
                self.client.update_run(run.info.run_id, status)
            else:
                self.client.set_terminated(run.info.run_id, status, end_ms)

    def put_artifact(self, run: "Run", name: str, content: bytes) -> None:
        """Store an artifact of a run, in place of an earlier one of that name.

        Raises:
            StoreError: its place is outside of the output directory that the store is part of.
        """
        # Not by the client where artifacts are files: it keeps their folder by run id, whatever the store, so that in
        # one process a copied output directory would write into the original's.
        if (path := self.artifact_path(run.info.artifact_uri, name)) is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path, durable=False) as temporary:
                temporary.write_bytes(content)
            return
        folder, _, last = name.rpartition("/")
        with TemporaryDirectory() as temporary_folder:
            file = Path(temporary_folder) / last
            file.write_bytes(content)
            self.client.log_artifact(run.info.run_id, str(file), folder or None)

    def artifact(self, run_id: str, folder_uri: str, name: str) -> bytes | None:
        """Return the content of a run's artifact, None where it has none of that name.

        Raises:
            StoreError: its place is outside of the output directory that the store is part of.
            Exception: it is there and can't be had; `client.reason` makes a sentence of it.
        """
        if (path := self.artifact_path(folder_uri, name)) is not None:
            try:
                return path.read_bytes()
            except FileNotFoundError:
                return None
        with TemporaryDirectory() as temporary:
            try:
                return Path(self.client.download_artifacts(run_id, name, temporary)).read_bytes()
            except Exception:
                if any(item.path == name for item in self.client.list_artifacts(run_id)):
                    raise
                return None

    def artifacts(self, places: Sequence[tuple[str, str]], name: str) -> Iterator[bytes | Exception | None]:
        """Yield what `artifact` returns or raises for each (run id, folder URI), several at a time."""

        def fetch(place: tuple[str, str]) -> bytes | Exception | None:
            try:
                return self.artifact(*place, name)
            except Exception as error:
                return error

        with ThreadPoolExecutor(DOWNLOADS_AT_ONCE) as pool:
            yield from pool.map(fetch, places)

    def artifact_path(self, folder_uri: str, name: str) -> Path | None:
        """Return the path of an artifact, None where artifacts are not files of this machine.

        Raises:
            StoreError: it is outside of the output directory that the store is part of.
        """
        self._refuse_elsewhere(folder_uri, name)
        folder = local_folder(folder_uri)
        return folder / name if folder else None

    def _refuse_elsewhere(self, folder_uri: str | None, name: str) -> None:
        """Refuse an artifact of an output directory's own store that lies elsewhere.

        Raises:
            StoreError: it does.
        """
        if (own := self._own_directory) is None:
            return
        folder = local_folder(folder_uri) if folder_uri else None
        if folder is None or not lies_inside(folder / name, own):
            raise StoreError(f"this store keeps artifacts outside of {own}, in {folder_uri}; use another experiment")


def _batches(values: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    for start in range(0, len(values), size):
        yield values[start : start + size]

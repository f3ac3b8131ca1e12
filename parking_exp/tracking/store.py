"""Find, create, update and delete runs of an MLflow store, and their artifacts; many processes may write at a time."""

import json
import logging
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from parking_exp.config.credentials import with_password
from parking_exp.config.paths import ARTIFACTS, database, lies_inside, local_folder
from parking_exp.config.schema import RunConfig
from parking_exp.errors import StoreError
from parking_exp.tracking.client import connect, write_lock
from parking_exp.tracking.failures import is_store_failure
from parking_exp.tracking.relocation import OUTPUT_DIR_TAG
from parking_exp.tracking.tags import experiment_tags

if TYPE_CHECKING:
    from mlflow.entities import Metric, Run

METRICS_A_BATCH, PARAMS_A_BATCH, RUNS_A_PAGE = 1000, 100, 1000  # MLflow's own limits


def own_directory(uri: str, output_dir: Path) -> Path | None:
    """Return the output directory if a store is its own, and so may come from elsewhere with it.

    Raises:
        StoreError: the database is a link that leads out of the directory.
    """
    path = database(uri)
    if path is None or not path.is_relative_to(output_dir):
        return None
    if not lies_inside(path, output_dir):
        raise StoreError(f"{path} is a symbolic link that leads out of {output_dir}; name the store with tracking.uri=")
    return output_dir


class Store:
    """A connection to a store. Only what writes takes its lock.

    Args:
        uri: the store.
        output_dir: of the runs. Its own store may come from elsewhere with it, and reaches artifacts below it only.

    Raises:
        StoreError: a link leads out of the output directory.
        Exception: what `client.connect` raises.
    """

    def __init__(self, uri: str, output_dir: Path) -> None:
        self.uri = uri
        self._own_directory = own_directory(uri, output_dir)
        self.client = connect(uri)
        self._lock = write_lock(uri)

    def find(self, run_id: str | None, experiment: str, tags: Mapping[str, str]) -> "Run | None":
        """Find a run that is not deleted: by its id, or by its tags where a kill came before the id was written.

        An id of a run with another key, or of a run directory that is elsewhere and still there, is none of ours:
        status.json may have been copied, or written by anybody.
        """
        from mlflow.exceptions import MlflowException

        if run_id is not None:
            try:
                run = self.client.get_run(run_id)
            except MlflowException as error:
                if error.error_code != "RESOURCE_DOES_NOT_EXIST":
                    raise
            else:
                if run.info.lifecycle_stage == "active" and run.data.tags.get("run_key") == tags["run_key"]:
                    place = self._place(run.data.tags.get("run_dir", ""))
                    if place is not None and (place == self._place(tags["run_dir"]) or not place.is_dir()):
                        return run
        found = self.client.get_experiment_by_name(experiment)
        if found is None:
            return None
        runs = self.client.search_runs([found.experiment_id], f"tags.run_key = '{tags['run_key']}'")
        place = self._place(tags["run_dir"])
        return next((run for run in runs if self._place(run.data.tags.get("run_dir", "")) == place), None)

    def statuses(self, experiments: Iterable[str]) -> dict[str, str]:
        """Return the tag `status` of every run of some experiments, by run id. Runs that a user has deleted are there.

        Experiments that the store does not have are passed over.
        """
        from mlflow.entities import ViewType

        found = [self.client.get_experiment_by_name(name) for name in experiments]
        ids, token = [one.experiment_id for one in found if one is not None], None
        statuses: dict[str, str] = {}
        while ids:
            page = self.client.search_runs(ids, "", ViewType.ALL, RUNS_A_PAGE, page_token=token)
            statuses |= {run.info.run_id: run.data.tags.get("status", "") for run in page}
            if not (token := page.token):
                break
        return statuses

    def create(self, config: RunConfig, tags: Mapping[str, str], start_ms: int | None) -> "Run":
        """Create a run, and its experiment if need be."""
        name = f"{config.cell}-seed={config.seed}"
        experiment_id = self._experiment(config)
        with self._lock:
            return self.client.create_run(experiment_id, start_time=start_ms, tags=dict(tags), run_name=name)

    def delete(self, run: "Run") -> None:
        """Delete a run, as MLflow's UI does: it can be restored there."""
        with self._lock:
            self.client.delete_run(run.info.run_id)

    def log(self, run: "Run", params: Mapping[str, str], tags: Mapping[str, str]) -> None:
        """Log parameters that the run does not have yet (they can't be changed), and tags that differ."""
        from mlflow.entities import Param, RunTag

        missing = [Param(key, value) for key, value in params.items() if key not in run.data.params]
        changed = [RunTag(key, value) for key, value in tags.items() if run.data.tags.get(key) != value]
        if changed:
            with self._lock:
                self.client.log_batch(run.info.run_id, tags=changed)
        for start in range(0, len(missing), PARAMS_A_BATCH):
            with self._lock:
                self.client.log_batch(run.info.run_id, params=missing[start : start + PARAMS_A_BATCH])

    def log_metrics(self, run: "Run", metrics: Sequence["Metric"]) -> None:
        """Log metrics, in this order; a batch is stored as a whole or not at all."""
        for start in range(0, len(metrics), METRICS_A_BATCH):
            with self._lock:
                self.client.log_batch(run.info.run_id, metrics=metrics[start : start + METRICS_A_BATCH])

    def set_status(self, run: "Run", status: str, mlflow_status: str, end_ms: int | None) -> None:
        """Set the tag `status`, and MLflow's own; `end_ms` is for a run that goes on no more."""
        if run.data.tags.get("status") == status and run.info.status == mlflow_status:
            return
        with self._lock:
            self.client.set_tag(run.info.run_id, "status", status)
            if end_ms is None:
                self.client.update_run(run.info.run_id, mlflow_status)
            else:
                self.client.set_terminated(run.info.run_id, mlflow_status, end_ms)

    def upload(self, run: "Run", file: Path, name: str) -> None:
        """Store a file as the artifact `name`, whose last part is the file's own name."""
        self._artifacts(run).log_artifact(str(file), name.rpartition("/")[0] or None)

    def upload_json(self, run: "Run", value: Any, name: str) -> None:
        """Store a value as a JSON artifact."""
        with TemporaryDirectory() as folder:
            file = Path(folder) / name.rpartition("/")[2]
            file.write_text(json.dumps(value, indent=2), encoding="utf-8")
            self.upload(run, file, name)

    def delete_artifact(self, run: "Run", name: str) -> None:
        """Delete an artifact or a folder of them, where the place of artifacts can do that and allows it."""
        try:
            self._artifacts(run).delete_artifacts(name)
        except Exception as error:  # this is tidying up, and a place of artifacts may not allow it
            if not isinstance(error, NotImplementedError) and not is_store_failure(error):
                raise
            logging.getLogger(__name__).debug("%s stays in the store: %s", name, error)

    def folders(self, run: "Run", name: str) -> list[str]:
        """Return the names of what lies in an artifact folder."""
        return [item.path.rpartition("/")[2] for item in self._artifacts(run).list_artifacts(name)]

    def _artifacts(self, run: "Run") -> Any:
        """Return MLflow's access to a run's artifacts. (Its client keeps one for each run id, whatever the store.)

        Raises:
            StoreError: they are outside of the output directory that the store is part of.
        """
        from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

        self._refuse_elsewhere(run.info.artifact_uri)
        return get_artifact_repository(run.info.artifact_uri, tracking_uri=with_password(self.uri))

    def _experiment(self, config: RunConfig) -> str:
        """Return the id of a run's experiment, made by one process of many."""
        from mlflow.exceptions import MlflowException

        name, location, tags = config.experiment_name, None, experiment_tags(config.experiment_name)
        # A tracking server has its own place for artifacts; a database would put them into the current directory.
        if not self.uri.startswith(("http", "databricks")):
            location = (config.output_path / ARTIFACTS / name).as_uri()
        own = {OUTPUT_DIR_TAG: str(self._own_directory)} if self._own_directory else {}
        with self._lock:
            experiment = self.client.get_experiment_by_name(name)
            if experiment is None:
                try:
                    return self.client.create_experiment(name, location, {**tags, **own})
                except MlflowException:  # without a lock of ours another process may have been first
                    experiment = self.client.get_experiment_by_name(name)
                    if experiment is None:
                        raise
            if experiment.lifecycle_stage == "deleted":
                restore = f"mlflow experiments restore --experiment-id {experiment.experiment_id}"
                raise StoreError(
                    f"the experiment {name} was deleted in this store: restore it with"
                    f" `MLFLOW_TRACKING_URI={shlex.quote(self.uri)} {restore}`,"
                    " or take another experiment_name"
                )
            self._refuse_elsewhere(experiment.artifact_location)
            for key, value in tags.items():
                if key not in experiment.tags:
                    self.client.set_experiment_tag(experiment.experiment_id, key, value)
        return experiment.experiment_id

    def _place(self, run_dir: str) -> Path | None:
        """Return the directory that the tag `run_dir` means, None where it is none."""
        path = database(self.uri)
        return ((path.parent if path else Path()) / run_dir).resolve() if run_dir.isprintable() else None

    def _refuse_elsewhere(self, place: str | None) -> None:
        """Refuse artifacts of an output directory's own store that are elsewhere.

        Raises:
            StoreError: they are.
        """
        if (own := self._own_directory) is None:
            return
        folder = local_folder(place) if place else None
        if folder is None or not lies_inside(folder, own):
            raise StoreError(f"this store keeps artifacts outside of {own}, in {place}; take another experiment_name")

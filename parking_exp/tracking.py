"""Metrics, parameters, tags and artifacts -> MLflow.

Values are written to the run directory first and sent from there in batches, only right after a checkpoint and when
the run is done. So a run that breaks and is resumed sends each step once, and the store agrees with the run
directory: what came after the last checkpoint had not been sent. (Where that checkpoint turns out to be corrupt and
the one before it is taken, the store keeps the points between the two as they were first.)
"""

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from filelock import FileLock

from parking_exp.config import RunConfig
from parking_exp.logs import MetricsLog
from parking_exp.provenance import provenance
from parking_exp.runs import RunDirectory

if TYPE_CHECKING:
    from mlflow import MlflowClient

SQLITE = "sqlite:///"
METRICS_A_BATCH, PARAMS_A_BATCH = 1000, 100  # MLflow's own limits
# MLflow cuts or refuses longer values; the whole config is an artifact besides.
LONGEST_PARAM = 6000
Ending = Literal["done", "failed", "interrupted"]
MLFLOW_STATUS = {"done": "FINISHED", "failed": "FAILED", "interrupted": "KILLED"}


def default_uri(output_dir: Path) -> str:
    """Return the URI of the embedded store under an output directory."""
    return f"{SQLITE}{output_dir / 'mlflow.db'}"


def store_uri(config: RunConfig) -> str:
    """Return the URI of a run's store; a sqlite path is made absolute, so that it means the same everywhere."""
    uri = config.tracking.uri or default_uri(config.output_path)
    return f"{SQLITE}{Path(uri.removeprefix(SQLITE)).absolute()}" if uri.startswith(SQLITE) else uri


def connect(uri: str) -> "MlflowClient":
    """Return a client of a store. Telemetry is off: nothing leaves the machine."""
    os.environ["MLFLOW_DISABLE_TELEMETRY"] = "true"  # read when mlflow is imported
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
    from mlflow import MlflowClient

    for name in ("alembic", "mlflow"):
        logging.getLogger(name).setLevel(logging.WARNING)
    if not uri.startswith(SQLITE):
        return MlflowClient(uri)
    database = Path(uri.removeprefix(SQLITE))
    database.parent.mkdir(parents=True, exist_ok=True)
    # Processes that open a fresh sqlite store at once collide in its migrations: one does it, the others wait.
    with FileLock(database.with_name(f".{database.name}.lock")):
        client = MlflowClient(uri)
        client.search_experiments(max_results=1)
    return client


class Tracker:
    """A run's link to a store. This one has none; `MlflowTracker` has."""

    run_id: str | None = None

    def flush(self) -> None:
        """Send what the run directory has and the store has not."""

    def log_file(self, path: Path, folder: str | None = None) -> None:
        """Store a file as an artifact."""

    def log_json(self, value: Any, name: str) -> None:
        """Store a value as a JSON artifact."""

    def keep_only(self, folder: str, names: Sequence[str]) -> None:
        """Delete what else lies in an artifact folder."""

    def end(self, status: Ending) -> None:
        """Close the store's run."""


class MlflowTracker(Tracker):
    """A run's MLflow run: created, or found again after the run was cut off."""

    def __init__(self, config: RunConfig, directory: RunDirectory) -> None:
        uri = store_uri(config)
        self.client = connect(uri)
        self.metrics = MetricsLog(directory.path / "metrics.jsonl")
        experiment_id = self._experiment(config, embedded=uri.startswith(SQLITE))
        tags = {
            "experiment": config.experiment_name,
            "cell": config.cell,
            "seed": str(config.seed),
            "run_key": config.run_key,
            "run_dir": str(directory.path),
            "status": "running",
            **provenance(),
        }
        found = self._find(experiment_id, tags, directory.run_id)
        if found is None:
            name = f"{config.cell}-seed={config.seed}"
            found = self.client.create_run(experiment_id, tags=tags, run_name=name).info.run_id
        self.run_id: str = found
        directory.update(run_id=self.run_id, tracking_uri=uri)
        self.client.update_run(self.run_id, status="RUNNING")
        self._log_params(flatten(config.plain()))
        for key, value in tags.items():
            self.client.set_tag(self.run_id, key, value)
        self.client.log_artifact(self.run_id, str(directory.path / "config.yaml"))
        self._sent = self._last_sent_steps()

    def flush(self) -> None:
        """Send metrics above the last step that the store has of each."""
        from mlflow.entities import Metric

        pending = [
            Metric(key, value, record["time_ms"], record["step"])
            for record in self.metrics.records()
            for key, value in record["metrics"].items()
            if record["step"] > self._sent.get(key, -1)
        ]
        for start in range(0, len(pending), METRICS_A_BATCH):
            batch = pending[start : start + METRICS_A_BATCH]
            self.client.log_batch(self.run_id, metrics=batch)
            self._sent |= {metric.key: metric.step for metric in batch}

    def log_file(self, path: Path, folder: str | None = None) -> None:
        """Store a file as an artifact."""
        self.client.log_artifact(self.run_id, str(path), folder)

    def log_json(self, value: Any, name: str) -> None:
        """Store a value as a JSON artifact."""
        self.client.log_dict(self.run_id, value, name)

    def keep_only(self, folder: str, names: Sequence[str]) -> None:
        """Delete what else lies in an artifact folder, where the store keeps artifacts on this machine's disk."""
        from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository

        uri = self.client.get_run(self.run_id).info.artifact_uri
        if not uri.startswith(("file:", "/")):
            return
        for item in self.client.list_artifacts(self.run_id, folder):
            if item.path.removeprefix(f"{folder}/") not in names:
                get_artifact_repository(uri).delete_artifacts(item.path)

    def end(self, status: Ending) -> None:
        """Close the MLflow run."""
        self.client.set_tag(self.run_id, "status", status)
        self.client.set_terminated(self.run_id, MLFLOW_STATUS[status])

    def _experiment(self, config: RunConfig, embedded: bool) -> str:
        """Return the id of the run's experiment, made if need be by one process of many."""
        location = config.output_path / "mlflow-artifacts" / config.experiment_name
        with FileLock(config.output_path / ".mlflow-experiment.lock"):
            experiment = self.client.get_experiment_by_name(config.experiment_name)
            if experiment is not None:
                return experiment.experiment_id
            return self.client.create_experiment(config.experiment_name, location.as_uri() if embedded else None)

    def _find(self, experiment_id: str, tags: Mapping[str, str], known: str | None) -> str | None:
        """Find this run in the store: by the id in its directory, or by tag where a kill came before the id."""
        runs = {
            run.info.run_id: run.data.tags.get("run_dir")
            for run in self.client.search_runs([experiment_id], f"tags.run_key = '{tags['run_key']}'")
        }
        if known in runs:
            return known
        return next((run_id for run_id, run_dir in runs.items() if run_dir == tags["run_dir"]), None)

    def _log_params(self, params: Mapping[str, str]) -> None:
        """Log the parameters that the run does not have yet: they can't be changed."""
        from mlflow.entities import Param

        known = self.client.get_run(self.run_id).data.params
        missing = [Param(key, value[:LONGEST_PARAM]) for key, value in params.items() if key not in known]
        for start in range(0, len(missing), PARAMS_A_BATCH):
            self.client.log_batch(self.run_id, params=missing[start : start + PARAMS_A_BATCH])

    def _last_sent_steps(self) -> dict[str, int]:
        keys = self.client.get_run(self.run_id).data.metrics
        return {key: max(metric.step for metric in self.client.get_metric_history(self.run_id, key)) for key in keys}


def open_tracker(config: RunConfig, directory: RunDirectory) -> Tracker:
    """Return the run's tracker."""
    return MlflowTracker(config, directory) if config.tracking.mlflow else Tracker()


def flatten(config: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Return nested mappings as one level with dotted keys; lists stay whole."""
    flat: dict[str, str] = {}
    for key, value in config.items():
        name = f"{prefix}{key}"
        flat |= flatten(value, f"{name}.") if isinstance(value, Mapping) and value else {name: str(value)}
    return flat

"""Read and write an MLflow store through its public client; many processes may write at a time."""

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from parking_exp.config.paths import (
    ARTIFACTS,
    absolute_uri,
    database_file,
    default_uri,
    is_same_store,
    lies_inside,
    local_folder,
)
from parking_exp.config.schema import RunConfig
from parking_exp.errors import StoreError
from parking_exp.runs.atomic_files import replacing
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import read_file
from parking_exp.tracking.client import connect, say_ignored_store, write_lock

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities import Metric, Run

OUTPUT_DIR_TAG = "parking_exp.output_dir"
"""Tag of experiments in an output directory's own store: the directory in which their artifacts are
located.
"""
# MLflow's limits are 100 parameters, 100 tags, and 1,000 entries in all.
METRICS_PER_BATCH = 800
PARAMS_PER_BATCH = 100
RUNS_PER_PAGE = 10_000  # one request for most stores
MAX_EXPERIMENTS = 50_000  # MLflow's limit


class Store:
    """An MLflow store; it connects at the first use.

    A store inside `output_dir` may come from other people. So its artifacts are read and written
    only below that directory. Artifacts of other stores may be anywhere.

    Args:
        uri: the URI of the store.
        output_dir: the output directory whose runs are read or written; None if it belongs to none.
    """

    def __init__(self, uri: str, output_dir: Path | None) -> None:
        self.uri = absolute_uri(uri)
        self.is_checked = False  # whether `rebuild_if_unusable` found it usable, or made it again
        self._database = database_file(self.uri)
        self._output_dir: Path | None = None
        if self._database and output_dir and self._database.is_relative_to(output_dir):
            self._output_dir = output_dir
        self._runs: dict[frozenset[str], list[Run]] = {}  # results of `runs`, by experiment ids

    @property
    def is_in_output_dir(self) -> bool:
        """Whether this is a database inside of the output directory."""
        return self._output_dir is not None

    @cached_property
    def client(self) -> "MlflowClient":
        """MLflow's client of the store, for reading; see `writing`. Raises what `client.connect`
        does.
        """
        if self._output_dir:
            say_ignored_store()
        self.refuse_link()
        return connect(self.uri)

    @property
    def embedded_database(self) -> Path | None:
        """The database file, if this is the output directory's default store."""
        if self._output_dir is None or self.uri != default_uri(self._output_dir):
            return None
        return self._database

    def tracks(self, directory: RunDirectory) -> bool:
        """Return whether a run directory names this store as its own."""
        uri = directory.tracking_uri
        return uri is not None and is_same_store(uri, self.uri)

    def refuse_link(self) -> None:
        """Raise StoreError if its file is a link that leads out of its output directory."""
        path = self._database
        root = self._output_dir
        if path and root and not lies_inside(path, root):
            raise StoreError(
                f"{path} is a symbolic link that leads out of {root}; name the store with "
                "tracking.uri="
            )

    @contextmanager
    def writing(self) -> "Iterator[MlflowClient]":
        """Yield MLflow's client, with the lock that all writers share."""
        client = self.client
        self._runs.clear()
        with write_lock(self.uri):
            yield client

    def experiment_ids(self) -> dict[str, str]:
        """Return the ids of all experiments that are not deleted, by name."""
        experiments = self.client.search_experiments(max_results=MAX_EXPERIMENTS)
        return {experiment.name: experiment.experiment_id for experiment in experiments}

    def runs(self, experiment_ids: Iterable[str]) -> "list[Run]":
        """Return all runs of some experiments.

        They are read once and kept until the next writing, since 1,000 take seconds.
        """
        ids = frozenset(experiment_ids)
        if ids not in self._runs:
            self._runs[ids] = self.search([*ids])
        return self._runs[ids]

    def search(self, experiment_ids: Sequence[str], condition: str = "") -> "list[Run]":
        """Return runs of experiments that match a filter of MLflow's, deleted ones too."""
        from mlflow.entities import ViewType

        runs: list[Run] = []
        token = None
        while True:
            page = self.client.search_runs(
                experiment_ids,
                condition,
                ViewType.ALL,
                RUNS_PER_PAGE,
                ["attributes.start_time"],
                token,
            )
            runs += page
            token = page.token
            if not token:
                return runs

    def run_dir(self, run: "Run") -> Path | None:
        """Return the run directory in a tag; relative ones start at the database's folder."""
        tag = run.data.tags.get("run_dir")
        if not tag or not tag.isprintable():
            return None
        return (self._database.parent if self._database else Path()) / tag

    def find_or_make_experiment(self, config: RunConfig) -> str:
        """Return the id of a run's experiment; make the experiment if there is none."""
        name = config.experiment_name
        # Else the UI shows traces and prompts of GenAI.
        tags = {"mlflow.experimentKind": "custom_model_development"}
        location = None
        # A tracking server has its own place for artifacts; a database would put them into the
        # current directory.
        if not self.uri.startswith(("http", "databricks")):
            location = (config.output_path / ARTIFACTS / name).as_uri()
        if self._output_dir:
            tags[OUTPUT_DIR_TAG] = str(self._output_dir)
        with self.writing() as client:
            experiment = client.get_experiment_by_name(name)
            if experiment is None:
                return client.create_experiment(name, location, tags)
        self.refuse_deleted(name)
        self._artifact_path(experiment.artifact_location, "")  # refuses one outside
        return experiment.experiment_id

    def refuse_deleted(self, name: str) -> None:
        """Raise StoreError if there is an experiment of a name, but it is deleted."""
        experiment = self.client.get_experiment_by_name(name)
        if experiment is not None and experiment.lifecycle_stage == "deleted":
            command = f"mlflow experiments restore --experiment-id {experiment.experiment_id}"
            raise StoreError(
                f"experiment={name} is deleted in MLflow; restore it by "
                f"`MLFLOW_TRACKING_URI={shlex.quote(self.uri)} {command}`, or choose another name"
            )

    def log(
        self,
        run: "Run",
        params: Mapping[str, str],
        tags: Mapping[str, str],
        metrics: Sequence["Metric"] = (),
    ) -> None:
        """Log parameters a run lacks (they can't be changed), tags that differ, and metrics."""
        from mlflow.entities import Param, RunTag

        missing = [Param(key, value) for key, value in params.items() if key not in run.data.params]
        changed = [
            RunTag(key, value) for key, value in tags.items() if run.data.tags.get(key) != value
        ]
        batches = zip_longest(
            _batches(metrics, METRICS_PER_BATCH),
            _batches(missing, PARAMS_PER_BATCH),
            _batches(changed, PARAMS_PER_BATCH),
            fillvalue=(),
        )
        for batch in batches:
            with self.writing() as client:
                client.log_batch(run.info.run_id, *batch)

    def has_artifacts(self, run: "Run", files: Mapping[str, Path]) -> bool:
        """Return whether the artifacts of a run have these names and sizes, as far as can be seen.

        Artifacts on a server, and those of a deleted run, count as present.
        """
        folder = local_folder(run.info.artifact_uri)
        if folder is None or run.info.lifecycle_stage == "deleted":
            return True
        for name, file in files.items():
            artifact = folder / name
            if not artifact.is_file() or artifact.stat().st_size != file.stat().st_size:
                return False
        return True

    def put_artifact(self, run: "Run", name: str, content: bytes) -> None:
        """Store a run's artifact in place of an earlier one of that name; see `_artifact_path`."""
        # MLflow's client caches folders by run id, whatever the store: a copied store would write
        # to the original's.
        path = self._artifact_path(run.info.artifact_uri, name)
        if path is not None:
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
        """Return the content of a run's artifact, None without one; see `_artifact_path`."""
        path = self._artifact_path(folder_uri, name)
        if path is not None:
            return read_file(path) if path.exists() else None
        if not any(item.path == name for item in self.client.list_artifacts(run_id)):
            return None
        with TemporaryDirectory() as temporary:
            return Path(self.client.download_artifacts(run_id, name, temporary)).read_bytes()

    def _artifact_path(self, folder_uri: str, name: str) -> Path | None:
        """Return the path of an artifact; None if artifacts are not local.

        Raises:
            StoreError: the store is inside an output directory, but the artifact is not.
        """
        folder = local_folder(folder_uri)
        path = folder / name if folder else None
        root = self._output_dir
        if root is not None and (path is None or not lies_inside(path, root)):
            raise StoreError(
                f"this store keeps artifacts outside of {root}, in {folder_uri}; use another "
                "experiment"
            )
        return path


def _batches(entries: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    """Yield entries in batches of a size."""
    for first in range(0, len(entries), size):
        yield entries[first : first + size]

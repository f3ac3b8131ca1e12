"""Write a run directory into an MLflow store; the directory is the truth, and the store its index.

A kill may have left the directory in any state. The tag `mirrored` of a stored run is a digest of
the files that the store has. This tag and `status` are written last, so a run is `done` in the
store only when everything is there. Metrics are written once they are final: up to the last
checkpoint while the run is unfinished, and all of them when it is done. Files that changed after
the run was finished are not written.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from parking_exp.config.paths import resolved
from parking_exp.config.settings import encode_setting, flatten_config
from parking_exp.errors import StoreError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.file_hashes import changed_files, has_hashes
from parking_exp.runs.foreign_files import read_file
from parking_exp.runs.metric_logs import METRICS_FILE, read_metrics
from parking_exp.runs.run_files import CONFIG_FILE
from parking_exp.runs.run_provenance import STARTED
from parking_exp.tracking.run_snapshot import (
    DIGEST,
    OUTPUT_ID,
    STATUS,
    RunSnapshot,
    take_snapshot,
)
from parking_exp.tracking.store import Store

if TYPE_CHECKING:
    from mlflow.entities import Metric, Run

MAX_PARAM_LENGTH = 6000  # MLflow refuses longer values; the whole config is also an artifact
MLFLOW_STATUS = {"done": "FINISHED", "failed": "FAILED"}  # others: KILLED


def write_run(directory: RunDirectory, store: Store) -> None:
    """Write what a store lacks of a run directory; idempotent."""
    _refuse_damage(directory)
    snapshot = take_snapshot(directory, store)
    tags = snapshot.tags
    experiment_id = store.find_or_make_experiment(snapshot.config)
    run, earlier = _find_stored_run(directory, store, experiment_id, tags)
    # A run that is evaluated again has no start time yet, or another one than its stored results.
    has_old_results = bool(earlier) or (run is not None and STARTED not in tags)
    if directory.is_evaluated_again and has_old_results:
        return  # the store keeps them until the new evaluation is done
    for replaced in earlier:
        with store.writing() as client:
            client.delete_run(replaced.info.run_id)  # it can be restored in MLflow's UI

    if run is None:
        first_tags = {**tags, STATUS: "running"}
        run = _create(store, experiment_id, first_tags, snapshot.first_name)
    _record_id(directory, run, store.uri)
    if _is_up_to_date(store, run, snapshot):
        return

    was_done = run.data.tags.get(STATUS) == "done"
    if snapshot.status == "done" and was_done and not has_hashes(directory.path):
        raise StoreError(
            "files changed, and result.json has no hashes to check them; the store keeps what it "
            "has"
        )

    _write_content(store, run, snapshot)
    _rename(store, run, snapshot)
    store.log(run, {}, snapshot.last_tags)


def write_new_run(
    directory: RunDirectory, store: Store, uri: str, experiment_ids: dict[str, str]
) -> None:
    """Write a run directory into a new store that nobody reads yet.

    The run gets its last tags and its last name at once.

    Args:
        directory: the run directory.
        store: the new store.
        uri: the URI of the store after it is renamed.
        experiment_ids: experiment ids of the store by name; the run's experiment is added.
    """
    _refuse_damage(directory)
    snapshot = take_snapshot(directory, store)
    name = snapshot.config.experiment_name
    if name not in experiment_ids:
        experiment_ids[name] = store.find_or_make_experiment(snapshot.config)
    all_tags = {**snapshot.tags, **snapshot.last_tags}
    run = _create(store, experiment_ids[name], all_tags, snapshot.last_name)
    _record_id(directory, run, uri)
    _write_content(store, run, snapshot)


def _refuse_damage(directory: RunDirectory) -> None:
    """Raise for links that lead elsewhere, and for files that changed since they were finished."""
    directory.check_links()
    changed = changed_files(directory.path)
    if changed:
        raise StoreError(
            f"{', '.join(changed)} changed after the run was finished; the store keeps what it "
            "has. Restore or delete the file to end this warning"
        )


def _is_up_to_date(store: Store, run: "Run", snapshot: RunSnapshot) -> bool:
    """Return whether a store has the current files and directory of a run."""
    is_same = run.data.tags.get(DIGEST) == snapshot.last_tags[DIGEST]
    is_here = run.data.tags.get("run_dir") == snapshot.tags["run_dir"]
    return is_same and is_here and store.has_artifacts(run, snapshot.files)


def _rename(store: Store, run: "Run", snapshot: RunSnapshot) -> None:
    """Show a success rate first in MLflow's UI: in a run's name, unless a user has given it one."""
    has_first_name = run.info.run_name == snapshot.first_name  # else a user has renamed it
    if has_first_name and snapshot.last_name != snapshot.first_name:
        with store.writing() as client:
            client.update_run(run.info.run_id, name=snapshot.last_name)


def _create(store: Store, experiment_id: str, tags: Mapping[str, str], name: str) -> "Run":
    start_ms = int(tags[STARTED]) if STARTED in tags else None
    with store.writing() as client:
        return client.create_run(experiment_id, start_ms, dict(tags), name)


def _record_id(directory: RunDirectory, run: "Run", uri: str) -> None:
    """Record a run's MLflow id and store in its directory."""
    run_id = run.info.run_id
    if directory.run_id != run_id or directory.tracking_uri != uri:
        directory.update_status(run_id=run_id, tracking_uri=uri)


def _write_content(store: Store, run: "Run", snapshot: RunSnapshot) -> None:
    """Write the parameters, tags, metrics, files and MLflow's own status of a run."""
    files = snapshot.files
    settings = flatten_config(snapshot.config.plain())
    params = {key: encode_setting(value)[:MAX_PARAM_LENGTH] for key, value in settings.items()}
    metrics = list(_new_metrics(run, files.get(METRICS_FILE)))
    store.log(run, params, snapshot.tags, metrics)
    for name, file in files.items():
        store.put_artifact(run, name, read_file(file))

    with store.writing() as client:
        if snapshot.status == "running":
            client.update_run(run.info.run_id, "RUNNING")
            return
        last = files.get(METRICS_FILE, files[CONFIG_FILE])
        end_ms = last.stat().st_mtime_ns // 1_000_000
        status = MLFLOW_STATUS.get(snapshot.status, "KILLED")
        client.set_terminated(run.info.run_id, status, end_ms)


def _new_metrics(run: "Run", log: Path | None) -> "Iterator[Metric]":
    """Yield the points of a metrics log that are later than the stored ones."""
    from mlflow.entities import Metric

    latest = {metric.key: metric.step for metric in run.data.to_proto().metrics}
    for record in read_metrics(log) if log else ():
        for key, value in record["metrics"].items():
            if record["step"] > latest.get(key, -1):
                yield Metric(key, value, record["time_ms"], record["step"])


def _find_stored_run(
    directory: RunDirectory, store: Store, experiment_id: str, tags: Mapping[str, str]
) -> "tuple[Run | None, list[Run]]":
    """Find the stored run of a directory, and older stored runs that it replaces.

    The run id in status.json may be copied or forged. So a stored run of another directory is taken
    only if that directory is gone, since then it was moved here. A shared store also has runs of
    other output directories, even with the same path on another machine. These runs are left alone.
    A run without an owner is taken only if it is the same training.
    """
    own_id = tags.get(OUTPUT_ID)  # None in the output directory's own store
    own_run: Run | None = None
    earlier = []
    for run in store.search([experiment_id], f"tags.run_key = '{tags['run_key']}'"):
        run_dir = store.run_dir(run)
        owner = run.data.tags.get(OUTPUT_ID)
        if run_dir is None or run.info.lifecycle_stage == "deleted" or owner not in (None, own_id):
            continue
        if resolved(run_dir) != resolved(directory.path):
            is_same = run.info.run_id == directory.run_id and not run_dir.is_dir()
        elif STARTED not in tags:
            is_same = owner == own_id
        else:
            is_same = run.data.tags.get(STARTED, tags[STARTED]) == tags[STARTED]
            if not is_same and owner == own_id:
                earlier.append(run)
        if is_same and own_run is None:
            own_run = run
    return own_run, earlier

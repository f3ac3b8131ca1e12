"""Mirror run directories to an MLflow store; the directory is the truth, and the store its index.

`mirror` sends what the store lacks of a run directory, in any state that a kill can leave it in.
The tag `mirrored` of a stored run is a digest of the files that the store has; it and the tag
`status` are written last, so that a run is `done` in the store once all of it is there. Metrics are
sent as soon as they are final: up to the last checkpoint, from which an interrupted run resumes,
and all of them when the run is done. Files of a finished run that have changed since are not sent.
"""

import os
import shlex
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from filelock import FileLock
from rich.progress import track

from parking_exp.config.cell_labels import setting_text, settings_of
from parking_exp.config.paths import (
    SQLITE,
    default_uri,
    is_same_store,
    resolved,
)
from parking_exp.config.schema import RunConfig
from parking_exp.errors import StoreError, plural
from parking_exp.runs.atomic_files import read_file
from parking_exp.runs.directory import RunDirectory, Status
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.metric_logs import METRICS_FILE, read_metrics
from parking_exp.runs.output_identity import output_id
from parking_exp.runs.run_files import CONFIG_FILE, STATUS_FILE
from parking_exp.terminal import console, program, say
from parking_exp.tracking.client import lock_path, no_garbage_collection, reason, write_lock
from parking_exp.tracking.embedded_store import (
    is_usable,
    remove_unfinished,
    set_aside,
    unfinished_path,
)
from parking_exp.tracking.store import Store
from parking_exp.tracking.stored_run import (
    DIGEST,
    OUTPUT_ID,
    STARTED,
    STATUS,
    digest_in_store,
    files_in_store,
    rate_in_name,
    status_in_store,
    tags_in_store,
)

if TYPE_CHECKING:
    from mlflow.entities import Metric, Run

FEW_RUNS = 20  # are sent in a second or two
WAIT_S = 120  # for another process that mirrors the same run
MAX_PARAM_LENGTH = 6000  # MLflow refuses longer values; the whole config is also an artifact
MLFLOW_STATUS = {"done": "FINISHED", "failed": "FAILED"}  # others: KILLED


def mirror(directory: RunDirectory, store: Store) -> None:
    """Make a store agree with a run directory; idempotent."""
    prepare(store)
    with FileLock(directory.path / ".sync.lock", timeout=WAIT_S):
        _send(directory, store, store.uri)


def prepare(store: Store) -> None:
    """Make the store inside of an output directory again from the run directories, if it can't be
    used.

    It is made under another name, and renamed. Runs that can't be sent are named, and left to the
    next sync.

    Raises whatever MLflow, SQLAlchemy or the disk raise.
    """
    path = store.own_database
    if path is None or (store.is_checked and path.exists()):
        return
    store.refuse_link()
    path.parent.mkdir(parents=True, exist_ok=True)
    if os.access(path.parent, os.W_OK):  # who can't write may still read
        with write_lock(store.uri):
            if not is_usable(path, path.parent):
                _build(path, store.uri)
    store.is_checked = True


def _build(path: Path, uri: str) -> None:
    """Make a store from the run directories beside it, in place of one that is there.

    Args:
        path: of the store.
        uri: of the store.
    """
    output_dir = path.parent
    remove_unfinished(path, output_dir)
    set_aside(path, output_dir)
    unfinished = unfinished_path(path)
    new = Store(f"{SQLITE}{unfinished}", output_dir)
    new.experiments()  # which makes it, even for no run
    directories = [RunDirectory(run_dir) for run_dir in find_runs(output_dir)]
    tracked = [
        run for run in directories if run.tracking_uri and is_same_store(run.tracking_uri, uri)
    ]
    is_quick = len(tracked) < FEW_RUNS
    experiment_ids: dict[str, str] = {}
    problems = []
    for directory in track(
        tracked, "making the store", console=console(stderr=True), transient=True, disable=is_quick
    ):
        try:
            with no_garbage_collection():
                _send(directory, new, uri, experiment_ids)
        except Exception as error:  # of this run; the store has the others
            problems.append(f"{directory.path}: {reason(error)}")
    unfinished.replace(path)
    lock_path(unfinished).unlink(missing_ok=True)
    if problems:
        say(f"the new store lacks {plural(len(problems), 'run')}, e.g. {problems[0]}", stderr=True)


def _send(
    directory: RunDirectory,
    store: Store,
    uri: str,
    new_experiments: dict[str, str] | None = None,
) -> None:
    """Send a run directory to a store.

    Args:
        directory: of the run.
        store: that gets it.
        uri: of the store, under the name that it is going to have.
        new_experiments: ids of the experiments of a store that is being made, which has none of
            the runs; a missing one is added. None: the store is complete.
    """
    is_new = new_experiments is not None
    config = directory.config()
    _refuse_damage(directory)
    status = status_in_store(directory)
    files = files_in_store(directory, status)
    digest = digest_in_store(directory, status, files)
    tags = tags_in_store(directory, config, store)
    if new_experiments is None:
        experiment_id = store.experiment_id(config)
    else:
        experiment_id = _new_experiment(config, store, new_experiments)
    run = None
    earlier: list[Run] = []
    if not is_new:
        run, earlier = _find(directory, store, experiment_id, tags)
    if directory.is_evaluated_again and (earlier or (run and STARTED not in tags)):
        return  # its results stay until that is done
    for each in earlier:
        with store.writing() as client:
            client.delete_run(each.info.run_id)  # it can be restored in MLflow's UI

    last_tags = {DIGEST: digest, STATUS: status}
    first_name = f"{config.cell}-seed={config.seed}"
    last_name = f"{rate_in_name(directory)}{first_name}" if status == "done" else first_name
    if is_new:
        # Nobody reads a store that is being made: its runs begin with their last tags and names.
        run = _create(store, experiment_id, tags | last_tags, last_name)
    elif run is None:
        run = _create(store, experiment_id, tags | {STATUS: "running"}, first_name)
    if directory.run_id != run.info.run_id or directory.tracking_uri != uri:
        directory.update(run_id=run.info.run_id, tracking_uri=uri)
    if not is_new:
        stored = (run.data.tags.get(DIGEST), run.data.tags.get("run_dir"))
        if stored == (digest, tags["run_dir"]) and store.has_artifacts(run, files):
            return
        _refuse_unverifiable(directory, run, status)

    _send_content(store, run, config, tags, files)
    _end(store, run, status, files)
    # What MLflow's UI shows first of a run. A name that a user gave it stays.
    if run.info.run_name == first_name != last_name:
        with store.writing() as client:
            client.update_run(run.info.run_id, name=last_name)
    store.log(run, {}, last_tags)


def _create(store: Store, experiment_id: str, tags: Mapping[str, str], name: str) -> "Run":
    start_ms = int(tags[STARTED]) if STARTED in tags else None
    with store.writing() as client:
        return client.create_run(experiment_id, start_ms, dict(tags), name)


def _refuse_unverifiable(directory: RunDirectory, run: "Run", status: Status) -> None:
    """Raise StoreError for a finished run that the store has, and whose change can't be checked."""
    is_finished = status == "done" and run.data.tags.get(STATUS) == "done"
    if is_finished and not directory.has_hashes:
        raise StoreError(
            "files changed, and result.json has no hashes to check them; the store keeps what it "
            "has"
        )


def _send_content(
    store: Store, run: "Run", config: RunConfig, tags: Mapping[str, str], files: Mapping[str, Path]
) -> None:
    """Send the parameters, tags, metrics and files of a run."""
    params = {}
    for key, value in settings_of(config.plain()).items():
        params[key] = setting_text(value)[:MAX_PARAM_LENGTH]
    store.log(run, params, tags, list(_new_metrics(run, files.get(METRICS_FILE))))
    for name, file in files.items():
        store.put_artifact(run, name, read_file(file))


def _end(store: Store, run: "Run", status: Status, files: Mapping[str, Path]) -> None:
    """Write MLflow's own status of a run, and when it ended."""
    with store.writing() as client:
        if status == "running":
            client.update_run(run.info.run_id, "RUNNING")
            return
        last = files.get(METRICS_FILE, files[CONFIG_FILE])
        end_ms = last.stat().st_mtime_ns // 1_000_000
        client.set_terminated(run.info.run_id, MLFLOW_STATUS.get(status, "KILLED"), end_ms)


def try_mirror(directory: RunDirectory, store: Store) -> str | None:
    """Mirror as far as the store allows; return the reason of a failure, or None.

    A failure stops no training, since the run directory has everything.
    """
    try:
        mirror(directory, store)
    except Exception as error:
        return reason(error)
    return None


def follow_store(directory: RunDirectory, config: RunConfig) -> bool:
    """Make a finished run one of the store that a command names; return whether it was tracked
    elsewhere.
    """
    if not config.tracking.mlflow or directory.status != "done":
        return False
    tracked_in = directory.tracking_uri
    if tracked_in is not None and (
        config.tracking.uri is None or is_same_store(tracked_in, config.store_uri)
    ):
        return False
    directory.update(tracking_uri=config.store_uri)
    return True


def mirror_missing(
    directories: Iterable[RunDirectory], store: Store
) -> Iterator[tuple[RunDirectory, str | None]]:
    """Mirror the runs that a store lacks or has an older state of, found by one search.

    Runs under way are skipped. The store that a run directory names is not connected to: it may
    come from elsewhere.

    Yields:
        Each run that the store lacked, and what kept it from being sent now, or None.
    """
    directories = list(directories)
    for directory in directories:
        if directory.is_status_damaged:
            yield (
                directory,
                f"{STATUS_FILE} can't be read; restore it, or rerun the command of the run",
            )
    tracked = [
        run for run in directories if (uri := run.tracking_uri) and is_same_store(uri, store.uri)
    ]
    idle = [directory for directory in tracked if not directory.is_locked]
    if not idle:
        return
    try:
        prepare(store)
        ids = store.experiments()
        names = {directory.path.parents[1].name for directory in idle}
        runs = store.runs(ids[name] for name in names if name in ids)
    except Exception as error:
        yield from ((directory, reason(error)) for directory in idle)
        return
    mirrored = {
        (resolved(run_dir), run.data.tags.get(DIGEST)): run
        for run in runs
        if (run_dir := store.run_dir(run))
    }
    for directory in idle:
        status = status_in_store(directory)
        files = files_in_store(directory, status)
        run = mirrored.get((resolved(directory.path), digest_in_store(directory, status, files)))
        if run is None or not store.has_artifacts(run, files):
            yield directory, try_mirror(directory, store)


def delete_stored(directory: RunDirectory, store: Store) -> None:
    """Mark what a store has of a directory as deleted.

    Raises:
        StoreError: the store fails.
    """
    try:
        prepare(store)
        own_id = None if store.is_own else output_id(directory.output_dir)
        experiment_id = store.experiments().get(directory.path.parents[1].name)
        runs = store.search([experiment_id]) if experiment_id else []
        for run in runs:
            run_dir = store.run_dir(run)
            is_same = run_dir is not None and resolved(run_dir) == resolved(directory.path)
            is_own = run.data.tags.get(OUTPUT_ID) == own_id
            if is_same and is_own and run.info.lifecycle_stage != "deleted":
                with store.writing() as client:
                    client.delete_run(run.info.run_id)
    except Exception as error:
        raise StoreError(
            f"{directory.path} is kept, since the store {store.uri} fails: {reason(error)}"
        ) from error


def mirror_problem(directories: Iterable[RunDirectory], store: Store) -> str | None:
    """Mirror what a store lacks of some runs; return a sentence if it still lacks some, with the
    command to run.
    """
    problems = [
        (directory, problem) for directory, problem in mirror_missing(directories, store) if problem
    ]
    if not problems:
        return None
    directory, problem = problems[0]
    incomplete = f"files and store differ for {plural(len(problems), 'run')}, e.g. {directory.path}"
    return f"{incomplete}: {problem}; {sync_hint(directory.output_dir, store.uri)}"


def _refuse_damage(directory: RunDirectory) -> None:
    """Raise for links that lead elsewhere, and for files that changed since they were finished."""
    directory.check_links()
    changed = directory.changed_files()
    if changed:
        raise StoreError(
            f"{', '.join(changed)} changed after the run was finished; the store keeps what it "
            "has. Restore the file, or delete it, and this warning goes"
        )


def _new_experiment(config: RunConfig, store: Store, ids: dict[str, str]) -> str:
    """Return the id of a run's experiment in a store that is being made, looked up once."""
    name = config.experiment_name
    if name not in ids:
        ids[name] = store.experiment_id(config)
    return ids[name]


def sync_hint(output_dir: Path, uri: str | None) -> str:
    """Return the command that sends what a store lacks; `uri` is the store, None for the embedded
    one.
    """
    words = [*program("status").split(), "sync=true"]
    if output_dir != Path("outputs").absolute():
        words.append(f"output_dir={output_dir}")
    if uri is not None and uri != default_uri(output_dir):
        words.append(f"tracking.uri={uri}")
    return f"`{shlex.join(words)}` sends what is missing"


def _find(
    directory: RunDirectory, store: Store, experiment_id: str, tags: Mapping[str, str]
) -> "tuple[Run | None, list[Run]]":
    """Return the store's run of a directory, and those of earlier trainings or evaluations in the
    same place.

    The id in status.json may have been copied, or written by anybody. A run of another directory is
    taken only if that
    is gone: then it was moved here. A shared store has runs of other output directories, some of
    which have the same
    path on another machine: their runs are left alone, and so is what has no owner, unless it is
    this very training.
    """
    own_id = tags.get(OUTPUT_ID)  # None in the output directory's own store
    found: Run | None = None
    earlier = []
    runs = store.search([experiment_id], f"tags.run_key = '{tags['run_key']}'")
    if not runs:  # or it was sent by an earlier version, whose keys were others
        same_seed = store.search([experiment_id], f"tags.seed = '{tags['seed']}'")
        runs = [run for run in same_seed if run.data.tags.get("run_dir") == tags["run_dir"]]
    for run in runs:
        run_dir = store.run_dir(run)
        owner = run.data.tags.get(OUTPUT_ID)
        if run_dir is None or run.info.lifecycle_stage == "deleted" or owner not in (None, own_id):
            continue
        if resolved(run_dir) != resolved(directory.path):
            if run.info.run_id == directory.run_id and not run_dir.is_dir():
                found = found or run
        elif STARTED not in tags:
            if owner == own_id:
                found = found or run
        elif run.data.tags.get(STARTED, tags[STARTED]) == tags[STARTED]:
            found = found or run
        elif owner == own_id:
            earlier.append(run)
    return found, earlier


def _new_metrics(run: "Run", log: Path | None) -> "Iterator[Metric]":
    """Yield the points of a log of metrics that come after those that the store has."""
    from mlflow.entities import Metric

    latest = {metric.key: metric.step for metric in run.data.to_proto().metrics}
    for record in read_metrics(log) if log else ():
        for key, value in record["metrics"].items():
            if record["step"] > latest.get(key, -1):
                yield Metric(key, value, record["time_ms"], record["step"])

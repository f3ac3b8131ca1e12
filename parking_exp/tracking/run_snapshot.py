"""Snapshot of a run directory for the MLflow store: status, files, tags and digest."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from parking_exp.config.paths import database_file, relative_path
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig
from parking_exp.errors import one_line
from parking_exp.runs.checkpoint_files import MODEL, find_checkpoints
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import read_object
from parking_exp.runs.metric_logs import METRICS_FILE
from parking_exp.runs.output_identity import output_id
from parking_exp.runs.run_files import (
    CONFIG_FILE,
    EVALUATIONS,
    WHOLE_AT_THE_END,
    Status,
    evaluation_files,
    find_evaluations,
)
from parking_exp.runs.run_provenance import PROVENANCE_FILE, STARTED
from parking_exp.tracking.store import Store

# Tags.
DIGEST = "mirrored"
STATUS = "status"
OUTPUT_ID = "output_id"
FROM_STATUS = ("command", "search", "trial")
INIT = "init_sha256"
MAX_ERROR_LENGTH = 500


@dataclass(frozen=True)
class RunSnapshot:
    """What a store should have of a run directory, as it is now.

    Attributes:
        status: see `StateForStore`.
        files: see `StateForStore`.
        tags: see `tags_for_store`.
        last_tags: those that are written once the store has everything else.
        first_name: the run's name in MLflow's UI, until it is done.
        last_name: its name once it is done, with its success rate.
    """

    config: RunConfig
    status: Status
    files: Mapping[str, Path]
    tags: Mapping[str, str]
    last_tags: Mapping[str, str]
    first_name: str
    last_name: str


def take_snapshot(directory: RunDirectory, store: Store) -> RunSnapshot:
    """Return what a store should have of a run directory."""
    config = directory.read_config()
    status, files, digest = state_for_store(directory)
    first_name = f"{config.cell_name}-seed={config.seed}"
    last_name = first_name
    rate = directory.read_status().success_rate
    if status == "done" and rate is not None:
        last_name = f"{rate:.1%} {first_name}"
    return RunSnapshot(
        config=config,
        status=status,
        files=files,
        tags=tags_for_store(directory, config, store),
        last_tags={DIGEST: digest, STATUS: status},
        first_name=first_name,
        last_name=last_name,
    )


class StateForStore(NamedTuple):
    """The state of a run directory that a store should have.

    Of its files, only `status.json` is read.

    Attributes:
        status: the run's status there.
        files: files by their names there.
        digest: a hash, by which a later state is seen to be another one.
    """

    status: Status
    files: Mapping[str, Path]
    digest: str


def state_for_store(directory: RunDirectory) -> StateForStore:
    """Return the state of a run directory that a store should have."""
    status = _status_for_store(directory)
    files = _files_for_store(directory, status)
    return StateForStore(status, files, _digest_for_store(directory, status, files))


def _status_for_store(directory: RunDirectory) -> Status:
    """Return a run's status; `interrupted` if it was killed or is pending."""
    status = directory.status
    was_killed = status == "running" and not directory.is_locked
    if status == "pending" or was_killed:
        return "interrupted"
    return status


def _digest_for_store(directory: RunDirectory, status: Status, files: Mapping[str, Path]) -> str:
    """Return a hash of status, error and tags, and of names, sizes and times of change of files."""
    entries = directory.read_status()
    state: list[Any] = [status]
    for name in ("error", *FROM_STATUS):
        state.append(getattr(entries, name))

    sent = list(files.values())
    provenance = directory.path / PROVENANCE_FILE
    if provenance.exists():
        sent.insert(0, provenance)

    content: list[Any] = [state]
    for file in sent:
        stat = file.stat()
        content.append([str(file.relative_to(directory.path)), stat.st_size, stat.st_mtime_ns])
    return short_hash(content)


def tags_for_store(directory: RunDirectory, config: RunConfig, store: Store) -> dict[str, str]:
    """Return the tags of a run except its status and digest.

    They overwrite tags of the same name in its provenance.
    """
    entries = directory.read_status()
    provenance = read_object(directory.path / PROVENANCE_FILE)
    tags = {}
    described = provenance.get("tags")
    if isinstance(described, dict):
        for name, value in described.items():
            if name not in (DIGEST, STATUS, OUTPUT_ID):
                tags[name] = str(value)
    if STARTED in provenance:
        tags[STARTED] = str(provenance[STARTED])
    for name in (*FROM_STATUS, INIT):
        value = getattr(entries, name)
        if value is not None:
            tags[name] = str(value)
    if not store.is_in_output_dir:
        tags[OUTPUT_ID] = output_id(directory.output_dir)

    tags["experiment"] = config.experiment_name
    tags["cell"] = config.cell_name
    tags["seed"] = str(config.seed)
    tags["run_key"] = config.run_key
    database_path = database_file(store.uri)
    if database_path is None:
        tags["run_dir"] = str(directory.path.absolute())
    else:
        tags["run_dir"] = relative_path(directory.path, database_path.parent)
    tags["error"] = ""
    if entries.status == "failed":
        tags["error"] = one_line(entries.error or "")[:MAX_ERROR_LENGTH]
    return tags


def _files_for_store(directory: RunDirectory, status: Status) -> dict[str, Path]:
    """Return the files for the store, by their names there.

    Files that grow while the run trains are sent once it has ended.
    """
    path = directory.path
    files = {CONFIG_FILE: path / CONFIG_FILE}
    checkpoints = find_checkpoints(directory.checkpoints)
    if checkpoints:
        # Rows after the checkpoint may be written again.
        files[METRICS_FILE] = checkpoints[-1] / METRICS_FILE
        files["checkpoint/model.zip"] = checkpoints[-1] / MODEL
    if status == "done":
        files[METRICS_FILE] = path / METRICS_FILE
    if status != "running":
        for name in WHOLE_AT_THE_END:
            files[name] = path / name
    for folder in find_evaluations(path):
        for file in evaluation_files(folder):
            files[f"{EVALUATIONS}/{folder.name}/{file.name}"] = file
    return {name: file for name, file in files.items() if file.is_file()}

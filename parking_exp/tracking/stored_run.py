"""What the store has of a run directory: status, files, tags, and a digest of them."""

from collections.abc import Mapping
from pathlib import Path

from parking_exp.config.paths import database, relative_path
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig
from parking_exp.errors import one_line
from parking_exp.runs.atomic_files import read_object
from parking_exp.runs.directory import EVALUATIONS, MODEL, WRITTEN_AT_THE_END, RunDirectory, Status
from parking_exp.runs.metric_logs import METRICS_FILE
from parking_exp.runs.output_identity import output_id
from parking_exp.runs.run_files import CONFIG_FILE
from parking_exp.runs.run_provenance import PROVENANCE_FILE
from parking_exp.tracking.store import Store

# Tags.
DIGEST = "mirrored"
STARTED = "started_ms"
STATUS = "status"
OUTPUT_ID = "output_id"
FROM_STATUS = ("command", "search", "trial")
MAX_ERROR_LENGTH = 500


def status_in_store(directory: RunDirectory) -> Status:
    """Return a run's status for the store, where one that was killed or is pending is
    `interrupted`.
    """
    status = directory.status
    return (
        "interrupted"
        if status == "pending" or (status == "running" and not directory.is_locked)
        else status
    )


def digest_in_store(directory: RunDirectory, status: Status, files: Mapping[str, Path]) -> str:
    """Return a hash of what the store should have of a run, `files` among it, without parsing any
    file.
    """
    entries, provenance = directory.read_status(), directory.path / PROVENANCE_FILE
    state = [status, *(entries.get(name) for name in ("error", *FROM_STATUS))]
    sent = [*([provenance] if provenance.exists() else []), *files.values()]
    stats = [(str(file.relative_to(directory.path)), file.stat()) for file in sent]
    return short_hash([state, *([name, stat.st_size, stat.st_mtime_ns] for name, stat in stats)])


def tags_in_store(directory: RunDirectory, config: RunConfig, store: Store) -> dict[str, str]:
    """Return the tags of a run except its status; they overwrite others of the same name in its
    provenance.
    """
    path, entries = database(store.uri), directory.read_status()
    provenance = read_object(directory.path / PROVENANCE_FILE)
    error = one_line(entries.get("error", "")) if entries.get("status") == "failed" else ""
    stored = provenance.get("tags")
    described = (
        {str(name): str(value) for name, value in stored.items()}
        if isinstance(stored, dict)
        else {}
    )
    return {
        **{
            name: value
            for name, value in described.items()
            if name not in (DIGEST, STATUS, OUTPUT_ID)
        },
        **({STARTED: str(provenance[STARTED])} if STARTED in provenance else {}),
        **{name: str(entries[name]) for name in FROM_STATUS if name in entries},
        **({} if store.is_own else {OUTPUT_ID: output_id(directory.output_dir)}),
        "experiment": config.experiment_name,
        "cell": config.cell,
        "seed": str(config.seed),
        "run_key": config.run_key,
        "run_dir": relative_path(directory.path, path.parent)
        if path
        else str(directory.path.absolute()),
        "error": error[:MAX_ERROR_LENGTH],
    }


def files_in_store(directory: RunDirectory, status: Status) -> dict[str, Path]:
    """Return the files for the store, by their names there; those that grow with the run come at
    its end.
    """
    path = directory.path
    files = {CONFIG_FILE: path / CONFIG_FILE}
    if checkpoints := sorted(directory.checkpoints.glob("step=*")):
        files[METRICS_FILE] = checkpoints[-1] / METRICS_FILE  # what is final of it
        files["checkpoint/model.zip"] = checkpoints[-1] / MODEL
    if status == "done":
        files[METRICS_FILE] = path / METRICS_FILE
    if status != "running":
        files |= {name: path / name for name in WRITTEN_AT_THE_END}
    for folder in directory.evaluations():
        files |= {
            f"{EVALUATIONS}/{folder.name}/{file.name}": file
            for file in sorted(folder.glob("[!.]*"))
        }
    return {name: file for name, file in files.items() if file.is_file()}


def rate_in_name(directory: RunDirectory) -> str:
    """Return the final success rate of a finished run as `98.6% `, or nothing where it has none."""
    rate = directory.read_status().get("success_rate")
    return "" if rate is None else f"{rate:.1%} "

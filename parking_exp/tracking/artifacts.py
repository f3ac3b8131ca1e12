"""Upload the files of a run to its store as artifacts."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parking_exp.runs.atomic_files import fingerprint, read_object
from parking_exp.runs.directory import RunDirectory
from parking_exp.tracking.store import Store

if TYPE_CHECKING:
    from mlflow.entities import Run

AT_THE_END = (
    "metrics.jsonl",
    "episodes.csv",
    "trajectories.npz",
    "curves.png",
    "video.mp4",
    "monitor.csv",
    "progress.csv",
    "traceback.txt",
)
# As in checkpoints.py, which imports torch: a command that only syncs can do without.
MODEL, BUFFER, STATE, MANIFEST = "model.zip", "replay_buffer.npz", "state.json", "manifest.json"

Sent = dict[str, list[int]]
"""Fingerprints of what was sent, by name in the store."""


def send(store: Store, run: "Run", directory: RunDirectory, under_way: bool, sent: Sent) -> None:
    """Send the files that have changed, and delete from the store what is gone and can't come back.

    Args:
        store: where to.
        run: of the store.
        directory: of the run.
        under_way: files that grow with the run are sent at its end.
        sent: kept up to date.
    """
    files = _files(directory, under_way)
    for name, file in files.items():
        try:
            state = fingerprint(file)  # before it is sent: what is written meanwhile is sent again
            if sent.get(name) == state:
                continue
            if file.name == MANIFEST:
                if (record := _buffer_record(file.parent)) is None:
                    continue
                store.upload_json(run, record, name)
            else:
                store.upload(run, file, name)
        except FileNotFoundError:
            if file.exists():
                raise
            continue  # training has deleted an old checkpoint meanwhile
        sent[name] = state
    _delete_stale(store, run, directory, sent, set(files))


def _delete_stale(store: Store, run: "Run", directory: RunDirectory, sent: Sent, names: set[str]) -> None:
    """Delete old checkpoints and the traceback of a failure that was overcome; other files that are gone here stay."""
    gone = {name for name in sent if name.startswith(("checkpoints/", "traceback.txt"))} - names
    stale = {"traceback.txt"} & gone
    kept = {folder.name for folder in checkpoint_folders(directory)}
    if kept and gone - stale:  # a user who has deleted all checkpoints made room, and no newer one replaces them
        stale |= {f"checkpoints/{folder}" for folder in set(store.folders(run, "checkpoints")) - kept}
    for name in stale:
        store.delete_artifact(run, name)
    for name in gone:
        del sent[name]


def _files(directory: RunDirectory, under_way: bool) -> dict[str, Path]:
    """Return the files to send, by their names in the store. Those that grow with the run come at its end."""
    path = directory.path
    files = {"config.yaml": path / "config.yaml"}
    for folder in checkpoint_folders(directory):
        files[f"checkpoints/{folder.name}/{MODEL}"] = folder / MODEL
        files[f"checkpoints/{folder.name}/replay_buffer.json"] = folder / MANIFEST
        files["metrics.jsonl"] = folder / "metrics.jsonl"  # what is final of it
    if not under_way:
        files |= {name: path / name for name in AT_THE_END}
        files |= {f"models/{name}": directory.models / name for name in ("best.zip", "final.zip")}
    return {name: file for name, file in files.items() if file.exists()} | dict(evaluations(directory))


def evaluations(directory: RunDirectory) -> Iterator[tuple[str, Path]]:
    """Yield the results of `scripts/evaluate.py`, with their names in the store."""
    for file in sorted((directory.path / "evaluations").glob("*/*")):
        if not file.name.startswith("."):  # half written
            yield f"evaluations/{file.parent.name}/{file.name}", file


def checkpoint_folders(directory: RunDirectory) -> list[Path]:
    """Return a run's checkpoints, the newest last."""
    return sorted(directory.checkpoints.glob("step=*"))


def _buffer_record(folder: Path) -> dict[str, Any] | None:
    """Return path, hash and size of a checkpoint's replay buffer, which stays in the run directory."""
    path, digest = folder / BUFFER, read_object(folder / MANIFEST).get(BUFFER)
    name = str(path.relative_to(folder.parents[1]))  # in the run directory, wherever that may be moved
    return {"path": name, "sha256": digest, "bytes": path.stat().st_size} if digest else None

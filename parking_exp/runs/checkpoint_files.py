"""The files of checkpoints: their names, their order, and whether they are whole."""

from pathlib import Path

from parking_exp.runs.foreign_files import read_object, sha256

CHECKPOINTS = "checkpoints"  # folder of a run directory
STEP_PREFIX = "step="
MODEL = "model.zip"
BUFFER = "replay_buffer.npz"
MANIFEST = "manifest.json"


def checkpoint_name(step: int) -> str:
    """Return the name of a checkpoint's folder; names sort by step."""
    return f"{STEP_PREFIX}{step:010d}"


def find_checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoints of a run's folder `checkpoints`, the newest last."""
    return sorted(folder.glob(f"{STEP_PREFIX}*"))


def saved_step(folder: Path) -> int:
    """Return the env step of the newest checkpoint of a run's folder `checkpoints`; 0 if empty."""
    steps = [path.name.removeprefix(STEP_PREFIX) for path in find_checkpoints(folder)]
    return max((int(step) for step in steps if step.isdecimal()), default=0)


def checkpoint_problem(folder: Path) -> str | None:
    """Return what is wrong with a checkpoint; None if all files have their hashes."""
    hashes = read_object(folder / MANIFEST)
    if not hashes:
        return f"{MANIFEST} is missing or damaged"
    for name, digest in hashes.items():
        file = folder / name
        if not file.is_file() or sha256(file) != digest:
            return f"{name} is missing or damaged"
    return None

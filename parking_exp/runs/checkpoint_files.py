"""The files of checkpoints: their names, their order, and whether they are whole."""

from pathlib import Path

from parking_exp.runs.foreign_files import read_object, sha256

CHECKPOINTS = "checkpoints"  # folder of a run directory
STEP_PREFIX = "step="
MODEL = "model.zip"
BUFFER = "replay_buffer.npz"
MANIFEST = "manifest.json"


def checkpoint_name(step: int) -> str:
    """Return the name of a checkpoint's folder."""
    return f"{STEP_PREFIX}{step:010d}"


def find_checkpoints(folder: Path) -> list[Path]:
    """Return the checkpoints of a run's folder `checkpoints`, the newest last."""
    paths = [path for path in folder.glob(f"{STEP_PREFIX}*") if _digits(path).isdecimal()]
    return sorted(paths, key=_step)


def saved_step(folder: Path) -> int:
    """Return the env step of the newest checkpoint of a run's folder `checkpoints`; 0 if empty."""
    checkpoints = find_checkpoints(folder)
    return _step(checkpoints[-1]) if checkpoints else 0


def _digits(path: Path) -> str:
    return path.name.removeprefix(STEP_PREFIX)


def _step(path: Path) -> int:
    return int(_digits(path))


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

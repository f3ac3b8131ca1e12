"""The record of runs that this user trained on this machine. Their classes are trusted.

The record is in the user's state directory, since run directories may come from other people. An
entry is a hash of a run's real path and its config. So a copy elsewhere is not trusted, and neither
is a changed config.
"""

import hashlib
import os
from contextlib import suppress
from pathlib import Path

from parking_exp.config.allowlist import unlisted_class
from parking_exp.config.paths import resolved
from parking_exp.config.schema import RunConfig
from parking_exp.runs.run_files import CONFIG_FILE


def record_training(run_dir: Path, config: RunConfig) -> None:
    """Record that a run is trained here, if its config has classes that are not on the allow-list.

    A user without a writable state directory has no record, and passes `trust=true`.
    """
    if unlisted_class(config) is None or was_trained_here(run_dir):
        return
    record = _record_path()
    if record is not None:
        with suppress(OSError):
            record.parent.mkdir(parents=True, exist_ok=True)
            with record.open("a", encoding="utf-8") as file:
                file.write(f"{_entry(run_dir)}\n")


def was_trained_here(run_dir: Path) -> bool:
    """Return whether this user has trained a run in this place with its present config."""
    record = _record_path()
    if record is None:
        return False
    try:
        return _entry(run_dir) in record.read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError:
        return False


def _entry(run_dir: Path) -> str:
    content = (run_dir / CONFIG_FILE).read_bytes()
    return hashlib.sha256(os.fsencode(resolved(run_dir)) + b"\0" + content).hexdigest()


def _record_path() -> Path | None:
    """Return the file of the record; None for a user without a state directory."""
    state = Path(os.environ.get("XDG_STATE_HOME", ""))
    if not state.is_absolute():  # which the XDG specification ignores
        state = Path(os.path.expanduser("~/.local/state"))  # noqa: PTH111  # `Path.expanduser` raises without a home
    return state / "parking_exp" / "trained_here" if state.is_absolute() else None

"""Hashes of the files that no longer change once a run or an evaluation has ended.

They are kept in `result.json` and in an evaluation's `summary.json`. The store does not take files
that differ from them.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.checkpoint_files import CHECKPOINTS, MODEL, find_checkpoints
from parking_exp.runs.foreign_files import read_object, sha256
from parking_exp.runs.metric_logs import METRICS_FILE
from parking_exp.runs.run_files import (
    CONFIG_FILE,
    RESULT_FILE,
    STATUS_FILE,
    SUMMARY_FILE,
    WHOLE_AT_THE_END,
    StatusEntries,
    evaluation_files,
    find_evaluations,
    read_entries,
)

HASHES = "sha256"


def hash_finished_files(run_dir: Path) -> dict[str, str]:
    """Return the hashes of a finished run's files, by their names."""
    return {str(file.relative_to(run_dir)): sha256(file) for file in _finished_files(run_dir)}


def write_summary(folder: Path, entries: Mapping[str, Any]) -> None:
    """Write the summary of an evaluation, its last file, with the hashes of the others."""
    others = [file for file in evaluation_files(folder) if file.name != SUMMARY_FILE]
    hashes = {file.name: sha256(file) for file in others}
    write_json(folder / SUMMARY_FILE, {**entries, HASHES: hashes})


def has_hashes(run_dir: Path) -> bool:
    """Return whether a run's files can be checked; if `result.json` is damaged they can't."""
    return isinstance(read_object(run_dir / RESULT_FILE).get(HASHES), dict)


def changed_files(run_dir: Path) -> list[str]:
    """Return the names of files that have changed since they were finished.

    Deleted files are not among them.
    """
    changed = []
    for folder in find_evaluations(run_dir):
        summary = folder / SUMMARY_FILE
        if read_object(summary):
            changed += _find_changed(evaluation_files(folder), summary)
        else:
            changed.append(summary)
    entries = read_entries(run_dir / STATUS_FILE, StatusEntries) or StatusEntries()
    if entries.status == "done":
        changed += _find_changed(_finished_files(run_dir), run_dir / RESULT_FILE)
    return [str(file.relative_to(run_dir)) for file in changed]


def _finished_files(run_dir: Path) -> list[Path]:
    """Return the files of a finished run that no longer change."""
    files = [run_dir / name for name in (CONFIG_FILE, METRICS_FILE, *WHOLE_AT_THE_END)]
    files += [folder / MODEL for folder in find_checkpoints(run_dir / CHECKPOINTS)]
    return [file for file in files if file.is_file()]


def _find_changed(files: Iterable[Path], record: Path) -> list[Path]:
    """Return the files whose hashes differ from a record; none if the record has no hashes."""
    hashes = read_object(record).get(HASHES)
    if not isinstance(hashes, dict):
        return []

    changed = []
    for file in files:
        name = str(file.relative_to(record.parent))
        if name in hashes and sha256(file) != hashes[name]:
            changed.append(file)
    return changed

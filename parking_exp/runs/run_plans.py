"""Planned runs: the files that a command writes before the runs begin."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from parking_exp.config.schema import RunConfig
from parking_exp.errors import RunLockedError
from parking_exp.runs.directory import (
    RESERVE,
    STATUS_LOCK,
    SUPERVISOR_LOCK,
    SYNC_LOCK,
    TRAINING_LOCK,
    RunDirectory,
)
from parking_exp.runs.run_files import CONFIG_FILE, STATUS_FILE
from parking_exp.runs.run_provenance import command_line

PLAN_FILES = {
    CONFIG_FILE,
    STATUS_FILE,
    STATUS_LOCK,
    SYNC_LOCK,
    SUPERVISOR_LOCK,
    TRAINING_LOCK,
    RESERVE,
}
"""All that the directory of a run that never began can hold."""


def write_plan(
    directory: RunDirectory, config: RunConfig, label: str, started: float | None, **entries: Any
) -> None:
    """Make a run pending, unless it is finished with these settings or another process works on it.

    Nothing is written if the run is locked, or if another process has begun it since `started`.

    Args:
        directory: the run's directory.
        config: the run's config.
        label: the label of its cell in this plan.
        started: the run's last start when the plan was made; None if it had not begun.
        entries: other entries of status.json.
    """
    if directory.is_locked:
        return
    with suppress(RunLockedError), directory.supervisor_lock():
        status = directory.read_status()
        if status.started != started:
            return
        if status.status != "done" or directory.needs_evaluation(config):
            make_pending(directory, config, label, **entries)


def make_pending(directory: RunDirectory, config: RunConfig, label: str, **entries: Any) -> None:
    """Write the files of a pending run, and reopen a finished run that needs another evaluation.

    The caller holds the supervisor lock. There is no fsync: after a power cut, the same command
    writes the files again. For the arguments see `write_plan`.
    """
    if directory.needs_evaluation(config):
        directory.reopen()
    tracking_uri = config.store_uri if config.tracking.mlflow else None
    directory.write_config(config)
    directory.update_status(
        durable=False,
        status="pending",
        error=None,
        killed=None,
        label=label,
        total_timesteps=config.total_timesteps,
        command=command_line(),
        tracking_uri=tracking_uri,
        **entries,
    )


def _never_began(directory: RunDirectory) -> bool:
    """Return whether a run was planned, and no process has begun it."""
    stored = directory.read_status()
    is_planned = stored.status == "pending" and stored.started is None
    return is_planned and {file.name for file in directory.path.iterdir()} <= PLAN_FILES


def delete_planned_run(directory: RunDirectory, before: Callable[[], None]) -> bool:
    """Delete the directory of a run that never began, and its parents if they are empty then.

    Args:
        directory: the run's directory.
        before: called first, with the run locked.

    Returns:
        Whether it was deleted. A run that has begun, or begins at this moment, is kept.
    """
    # Not by locking: that would leave a lock file in the directory of every other run.
    if directory.is_locked or not _never_began(directory):
        return False
    try:
        with directory.supervisor_lock():
            if not _never_began(directory):
                return False
            before()
            for file in directory.path.iterdir():
                file.unlink()
    except RunLockedError:
        return False
    with suppress(OSError):  # it has other files, or its cell other runs
        for folder in (directory.path, *directory.path.parents[:2]):
            folder.rmdir()
    return True

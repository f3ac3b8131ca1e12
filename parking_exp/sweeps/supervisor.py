"""Supervise a run: start its worker process, wait for it, and record in the directory how it ended.

All launchers train runs like this. If the supervisor dies, its worker dies with it.
"""

import math
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from parking_exp.config.paths import absolute_path
from parking_exp.errors import ConfigError, OutputDirectoryError, RunLockedError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_files import CONFIG_FILE
from parking_exp.sweeps.worker import LOCKED_EXIT, LOG_FILE
from parking_exp.sweeps.worker_process import SERVER_LOST, StartMethod, WorkerProcess
from parking_exp.training.signals import StopRequest, stop_on_signal

GRACE_S = 8.0  # to save a checkpoint after a signal, before the process is killed
POLL_S = 0.05
# Signals from outside; any other signal is an error of the run.
KILLS = {signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP}

WorkerResult = Literal["done", "failed", "interrupted", "elsewhere"]
"""How a run ended: done; failed, with the reason in status.json; interrupted, on request;
elsewhere: in another process.
"""
Cause = Literal["late", "interrupted"]
"""Why a supervisor ends a worker."""


def supervise(
    path: Path,
    stop: StopRequest,
    cores: Sequence[int] = (),
    device: str | None = None,
    start_method: StartMethod = "spawn",
) -> WorkerResult:
    """Train one run in a process of its own, and record in its directory how it ended.

    Args:
        path: the run directory, with its config.
        stop: once it is made, the run saves a checkpoint and exits, or is killed after GRACE_S.
        cores: the cores that the worker may use, with a thread each. If empty, it may use all.
        device: the CUDA device that the worker may use; by default all.
        start_method: how its process starts.
    """
    directory = RunDirectory(path)
    if directory.is_locked:
        return "elsewhere"
    try:
        with directory.supervisor_lock():
            status = directory.status
            if status in ("done", "failed"):
                return status  # by another sweep, since this one was planned
            return _run(directory, WorkerProcess(path, cores, device, start_method), stop)
    except RunLockedError:
        return "elsewhere"


def _run(directory: RunDirectory, process: WorkerProcess, stop: StopRequest) -> WorkerResult:
    """Start a run's process, and return how the run ended."""
    try:
        config = directory.read_config()
        if config.run_dir != absolute_path(directory.path):
            raise ConfigError(
                f"{directory.path / CONFIG_FILE} is the config of another run; rerun the sweep"
            )
        directory.reserve()
    except (ConfigError, OutputDirectoryError) as error:
        directory.update_status(status="failed", error=str(error))
        return "failed"
    # Begin before the worker starts; later, this would overwrite the worker's entries.
    directory.begin()
    process.start()
    try:
        directory.update_status(pid=process.pid)
        cause = _wait(process, config.timeout_s, stop)
    finally:
        if process.exit_status is None:  # an error here: no worker is left without a supervisor
            process.kill()
    exit_status = process.exit_status
    assert exit_status is not None
    return _record_end(directory, exit_status, cause, config.timeout_s)


def _wait(process: WorkerProcess, timeout_s: float | None, stop: StopRequest) -> Cause | None:
    """Wait until a worker has ended, or end it if it is late or asked to stop; return why."""
    deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
    while process.exit_status is None:
        time.sleep(POLL_S)
        if time.monotonic() > deadline:
            _stop_worker(process)
            return "late"
        if stop.is_made:
            _stop_worker(process)
            return "interrupted"
    return None


def _stop_worker(process: WorkerProcess) -> None:
    """Ask a worker to stop, and kill it if it has not after GRACE_S."""
    process.terminate()
    deadline = time.monotonic() + GRACE_S
    while process.exit_status is None:
        time.sleep(POLL_S)
        if time.monotonic() > deadline:
            process.kill()


def _record_end(
    directory: RunDirectory, exit_status: int, cause: Cause | None, timeout_s: float | None
) -> WorkerResult:
    """Return how a run ended, from its worker's exit status and status.json, and record it."""
    status = directory.status
    if status == "done":
        return "done"
    if exit_status == LOCKED_EXIT:
        return "elsewhere"
    if cause == "late":
        directory.update_status(
            status="failed", error=f"ran past timeout_s={timeout_s:g}", killed=None
        )
        return "failed"
    if status == "failed":
        return "failed"
    if cause == "interrupted" or status == "interrupted":
        directory.update_status(status="interrupted")
        return "interrupted"
    was_killed = exit_status == SERVER_LOST or -exit_status in KILLS
    reason = _describe_exit(directory, exit_status)
    directory.update_status(status="failed", error=reason, killed=was_killed or None)
    return "failed"


def _describe_exit(directory: RunDirectory, exit_status: int) -> str:
    """Say why a worker exited without recording how its run ended."""
    if exit_status == -signal.SIGKILL:
        return "killed by SIGKILL (out of memory?)"
    if exit_status < 0:
        return f"killed by {signal.Signals(-exit_status).name}"
    if exit_status == SERVER_LOST:
        return "its process was lost, as the server that it was forked from was killed"
    log = directory.path / LOG_FILE
    return f"its process ended with status {exit_status} and without a result; see {log}"


def supervise_job(path: Path) -> None:
    """Train the run of a directory, as a job of a cluster.

    Raises:
        KeyboardInterrupt: a signal stopped it; not an Exception, so that launchers start no further
            job.
    """
    # Submitit sends SIGUSR2 when the time is nearly up.
    signals = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR2)
    with stop_on_signal(None, signals) as stop:
        supervise(path, stop)
    if stop.is_made:
        raise KeyboardInterrupt

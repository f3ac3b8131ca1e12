"""The slurm launcher: runs as jobs of submitit, on a Slurm cluster or on this machine."""

import importlib.util
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from parking_exp.errors import ConfigError, FailedRunError, suggestion
from parking_exp.resources import cores
from parking_exp.runs.directory import RunDirectory
from parking_exp.sweeps.supervisor import GRACE_S

POLL_S = 0.2
SLURM_POLL_S = 5.0
CLUSTERS = ("slurm", "local")


def check(executor: str) -> None:
    """Refuse an unknown executor, or one that is not installed here.

    Raises:
        ConfigError: with what to type instead.
    """
    if executor not in CLUSTERS:
        raise ConfigError(f"hydra.launcher.executor={executor} is not a valid choice{suggestion(executor, CLUSTERS)}")
    if importlib.util.find_spec("submitit") is None:
        raise ConfigError("hydra/launcher=slurm: submitit is not installed; pip install 'parking-exp[slurm]'")
    if executor == "slurm" and shutil.which("srun") is None:
        raise ConfigError(
            "hydra/launcher=slurm: there is no Slurm here, srun is not found; hydra.launcher.executor=local uses this "
            "machine instead"
        )


def launch(
    task: Callable[[str], Any],
    paths: Sequence[Path],
    executor: str,
    n_jobs: int | None,
    folder: Path,
    parameters: Mapping[str, Any],
) -> list[Any]:
    """Do a task for each path as jobs, wait for them, and return what each returned, or the error of one that broke.

    Ctrl-C cancels the jobs, which save their states. Jobs outlive a launcher that is killed, and the runs that they
    hold are left to them when the sweep is typed again.

    Args:
        task: called with a path, in a job.
        paths: run directories with frozen configs, or folders of searches, on a file system that the nodes share.
        executor: `slurm`, or `local` for processes of this machine, as `check` lets through.
        n_jobs: how many at a time; None: as many as the cluster takes, or this machine has cores.
        folder: for submitit's own scripts and logs.
        parameters: of `submitit.AutoExecutor.update_parameters`.

    Raises:
        ConfigError: submitit refuses a parameter.
        FailedRunError: jobs cannot be submitted.
    """
    import submitit

    try:
        jobs = submitit.AutoExecutor(folder=folder / "%j", cluster=executor)
        limit = {"slurm_array_parallelism": n_jobs} if executor == "slurm" and n_jobs else {}
        jobs.update_parameters(**{key: value for key, value in parameters.items() if value is not None}, **limit)
    except (RuntimeError, NameError, TypeError, ValueError) as error:
        raise ConfigError(f"hydra.launcher: submitit refuses its parameters: {error}") from error
    texts, submitted = [str(path) for path in paths], []
    try:
        if executor == "slurm":  # one array, and Slurm keeps to its limit
            with _sigint_blocked():  # Ctrl-C is to find all that was submitted
                submitted += jobs.map_array(task, texts)
        elif n_jobs is None:
            n_jobs = len(cores())
        while len(submitted) < len(texts) or any(not job.done() for job in submitted):
            under_way = sum(not job.done() for job in submitted)
            while len(submitted) < len(texts) and (n_jobs is None or under_way < n_jobs):
                with _ignored_by_children():
                    submitted.append(jobs.submit(task, texts[len(submitted)]))
                under_way += 1
            time.sleep(SLURM_POLL_S if executor == "slurm" else POLL_S)
    except submitit.core.utils.FailedJobError as error:
        raise FailedRunError(f"submitit cannot submit: {error}") from error
    except BaseException:
        _cancel(submitted, paths, executor)
        raise
    return [_result(job) for job in submitted]


def _cancel(submitted: Sequence[Any], paths: Sequence[Path], executor: str) -> None:
    """Ask jobs to stop, and wait a while until their runs are saved."""
    for job in submitted:
        if job.done():
            continue
        if executor == "local":  # its `cancel` kills within a second; SIGTERM is passed on to the run
            with suppress(ProcessLookupError):
                os.kill(int(job.job_id), signal.SIGTERM)
        else:
            job.cancel(check=False)
    deadline = time.monotonic() + GRACE_S + 1
    begun = paths[: len(submitted)]
    while time.monotonic() < deadline and (
        any(RunDirectory(path).under_way for path in begun)
        or (executor == "local" and any(not job.done() for job in submitted))
    ):
        time.sleep(POLL_S)


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Hold back SIGINT until the end of the block."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def _ignored_by_children() -> Iterator[None]:
    """Have processes that are started now ignore a terminal's SIGINT; `_cancel` asks them to stop."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _result(job: Any) -> Any:
    """Return what a job returned, or the error that submitit found instead."""
    error = job.exception()
    return error if error is not None else job.result()

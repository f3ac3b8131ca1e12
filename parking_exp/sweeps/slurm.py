"""The slurm launcher: jobs of submitit, on a Slurm cluster or as processes of this machine.

The end of a job is judged by `squeue` and result files: without accounting, submitit does not notice that a job was
cancelled, ran out of time or lost its node.
"""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from parking_exp.errors import ConfigError, FailedRunError
from parking_exp.resources import cores
from parking_exp.sweeps.supervisor import GRACE_S
from parking_exp.terminal import say

POLL_S = 0.2
SLURM_POLL_S = 5.0
MAX_ARRAY_SIZE = 1000  # jobs; Slurm's default of MaxArraySize is 1001


def make_executor(executor: str, folder: Path, parameters: Mapping[str, Any]) -> Any:
    """Return submitit's executor with these parameters; ConfigError if it refuses them, or finds no Slurm."""
    import submitit

    try:
        auto_executor = submitit.AutoExecutor(folder=folder / "%j", cluster=executor)
        auto_executor.update_parameters(**{key: value for key, value in parameters.items() if value is not None})
    except (NameError, TypeError, ValueError, AssertionError, RuntimeError) as error:
        raise ConfigError(f"hydra.launcher: {str(error).splitlines()[0]}") from error
    return auto_executor


def launch(
    task: Callable[[Any], Any],
    jobs: Sequence[Any],
    executor: str,
    n_jobs: int | None,
    folder: Path,
    parameters: Mapping[str, Any],
) -> list[Any]:
    """Run jobs, wait for them, and return what each returned, or its error.

    Ctrl-C cancels the jobs, which save their states. Jobs outlive a launcher that is killed; a rerun leaves their runs
    to them.

    Args:
        task: called with each of `jobs`, whose paths must be on a file system that the nodes share.
        executor: `slurm`, or `local` for processes of this machine.
        n_jobs: how many at a time; None: as many as the cluster takes, or this machine has cores.

    Raises:
        FailedRunError: jobs cannot be submitted.
    """
    import submitit

    if executor == "slurm":  # of an array; submitit's own limit is 256
        parameters = {"slurm_array_parallelism": n_jobs or len(jobs), **parameters}
    submitter = make_executor(executor, folder, parameters)
    submitted: list[Any] = []
    try:
        if executor == "slurm":
            while len(submitted) < len(jobs):
                with _sigint_blocked():  # Ctrl-C has to find all that was submitted
                    submitted += submitter.map_array(task, jobs[len(submitted) :][:MAX_ARRAY_SIZE])
                _wait(submitted)  # n_jobs holds within an array only
        else:
            while len(submitted) < len(jobs) or any(not job.done() for job in submitted):
                if len(submitted) < len(jobs) and sum(not job.done() for job in submitted) < (n_jobs or len(cores())):
                    with _sigint_blocked():  # also in the job; `_cancel` asks it to stop
                        submitted.append(submitter.submit(task, jobs[len(submitted)]))
                else:
                    time.sleep(POLL_S)
    except submitit.core.utils.FailedJobError as error:
        _cancel(submitted, executor)  # earlier arrays
        raise FailedRunError(f"submitit cannot submit: {str(error).splitlines()[-1]}") from error
    except BaseException:
        _cancel(submitted, executor)
        raise
    return [_result(job) for job in submitted]


def _wait(jobs: Sequence[Any], deadline: float = float("inf")) -> None:
    """Wait until no job without a result is queued or running; warn of the first failure of `squeue`."""
    warned = False
    while time.monotonic() < deadline and (unfinished := [job for job in jobs if not _has_result(job)]):
        try:
            command = ["squeue", "--noheader", "--array", "--format=%i", f"--user={os.getuid()}"]
            listed = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout.split()
            if not any(job.job_id in listed for job in unfinished):
                return
        except (subprocess.SubprocessError, OSError) as error:  # e.g. the controller is being restarted
            if not warned:
                say(f"warning: {error}; trying again", stderr=True)
            warned = True
        time.sleep(SLURM_POLL_S)


def _has_result(job: Any) -> bool:
    """Return whether a job has written its result; changing its folder's mode makes NFS look again."""
    folder = job.paths.folder
    folder.chmod(folder.stat().st_mode)
    return bool(job.paths.result_pickle.exists())


def _cancel(submitted: Sequence[Any], executor: str) -> None:
    """Ask jobs to stop, and wait a while until their runs are saved."""
    deadline = time.monotonic() + GRACE_S + 1
    if executor == "slurm" and submitted:
        subprocess.run(["scancel", "--quiet", *(job.job_id for job in submitted)], check=False)
        _wait(submitted, deadline)
    elif executor == "local":
        for job in submitted:
            if not job.done():  # its `cancel` kills within a second; SIGTERM is passed on to the run
                with suppress(ProcessLookupError):
                    os.kill(int(job.job_id), signal.SIGTERM)
        while time.monotonic() < deadline and any(not job.done() for job in submitted):
            time.sleep(POLL_S)


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Hold back SIGINT until the end of the block, and for good in processes that are started in it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _result(job: Any) -> Any:
    """Return what a job returned, or the error that it ended with."""
    if not _has_result(job):
        return FailedRunError(f"stopped by Slurm or a signal; rerun the same command (log: {job.paths.stderr})")
    try:
        return job.result()
    except Exception as error:  # what the job raised; a result that can't be unpickled may raise anything
        return FailedRunError(f"{type(error).__name__} (log: {job.paths.stderr})")

"""The slurm launcher: runs as jobs of submitit, on a Slurm cluster or on this machine."""

import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from parking_exp.errors import ConfigError, FailedRunError, suggestion
from parking_exp.resources import cores
from parking_exp.runs.directory import RunDirectory
from parking_exp.sweeps.supervisor import GRACE_S
from parking_exp.terminal import say

POLL_S = 0.2
SLURM_POLL_S = 5.0
MAX_ARRAY_SIZE = 1001  # Slurm's default
RULE = "-" * 22  # around the traceback in submitit's message
CLUSTERS = ("slurm", "local")


def make_executor(executor: str, folder: Path, parameters: Mapping[str, Any]) -> Any:
    """Return submitit's executor with these parameters.

    Raises:
        ConfigError: there is no such executor, no Slurm or no submitit here, or it refuses a parameter.
    """
    if executor not in CLUSTERS:
        raise ConfigError(f"hydra.launcher.executor={executor} is not a valid choice{suggestion(executor, CLUSTERS)}")
    if executor == "slurm" and shutil.which("srun") is None:
        raise ConfigError(
            "hydra/launcher=slurm: there is no Slurm here, srun is not found; hydra.launcher.executor=local uses this "
            "machine instead"
        )
    try:
        import submitit

        made = submitit.AutoExecutor(folder=folder / "%j", cluster=executor)
        made.update_parameters(**{key: value for key, value in parameters.items() if value is not None})
    except ImportError as error:
        raise ConfigError(
            "hydra/launcher=slurm: submitit is not installed; pip install 'parking-exp[slurm]'"
        ) from error
    except (NameError, TypeError, ValueError, AssertionError) as error:
        raise ConfigError(f"hydra.launcher.parameters: {str(error).splitlines()[0]}") from error
    return made


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
        executor: `slurm`, or `local` for processes of this machine, as `make_executor` accepts.
        n_jobs: how many at a time; None: as many as the cluster takes, or this machine has cores.
        folder: for submitit's own scripts and logs.
        parameters: of `submitit.AutoExecutor.update_parameters`.

    Raises:
        ConfigError: submitit refuses a parameter.
        FailedRunError: jobs cannot be submitted.
    """
    import submitit

    if executor == "slurm":  # of an array; submitit's own limit is 256
        parameters = {"slurm_array_parallelism": n_jobs or len(paths), **parameters}
    jobs = make_executor(executor, folder, parameters)
    texts = [str(path) for path in paths]
    submitted: list[Any] = []
    try:
        if executor == "slurm":
            size = max_array_size(_output_of("scontrol", "show", "config"))
            while len(submitted) < len(texts):
                with _sigint_blocked():  # Ctrl-C is to find all that was submitted
                    submitted += jobs.map_array(task, texts[len(submitted) :][:size])
                if n_jobs or len(submitted) == len(texts):  # the limit holds within an array only
                    _wait(submitted)
        else:
            n_jobs = n_jobs or len(cores())
            while len(submitted) < len(texts) or any(not job.done() for job in submitted):
                while len(submitted) < len(texts) and sum(not job.done() for job in submitted) < n_jobs:
                    with _sigint_blocked():  # also in the job; `_cancel` asks it to stop
                        submitted.append(jobs.submit(task, texts[len(submitted)]))
                time.sleep(POLL_S)
    except submitit.core.utils.FailedJobError as error:
        _cancel(submitted, paths, executor)  # earlier arrays
        raise FailedRunError(f"submitit cannot submit: {str(error).splitlines()[-1]}") from error
    except BaseException:
        _cancel(submitted, paths, executor)
        raise
    return [_result(job, executor) for job in submitted]


def max_array_size(config: str) -> int:
    """Return how many jobs an array can have, from the output of `scontrol show config`."""
    found = re.search(r"^MaxArraySize\s*=\s*(\d+)", config, re.MULTILINE)
    return max(1, int(found[1])) if found else MAX_ARRAY_SIZE  # 0: the cluster takes no arrays


def _wait(jobs: Sequence[Any]) -> None:
    """Wait until no job is under way; warn once when `squeue` fails, and again only after it has worked."""
    warned = False
    while True:
        try:
            if not _under_way(jobs):
                return
            warned = False
        except FailedRunError as error:  # e.g. the controller is being restarted
            if not warned:
                say(f"warning: {error}", stderr=True)
            warned = True
        time.sleep(SLURM_POLL_S)


def _under_way(jobs: Sequence[Any]) -> list[Any]:
    """Return the jobs of Slurm that have no result yet and that `squeue` lists.

    Where there is no accounting, Slurm tells no more about a job that was cancelled, ran out of time or lost its node
    than that it is gone.

    Raises:
        FailedRunError: squeue fails.
    """
    left = [job for job in jobs if not _has_result(job)]
    if not left:
        return []
    listed = _output_of("squeue", "--noheader", "--array", "--format=%i", f"--user={os.getuid()}").split()
    return [job for job in left if job.job_id in listed]


def _output_of(*command: str) -> str:
    """Return what a command of Slurm prints.

    Raises:
        FailedRunError: it fails, cannot be started or takes more than a minute.
    """
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FailedRunError(f"{command[0]} failed: {error}") from error
    if done.returncode:
        raise FailedRunError(f"{command[0]} failed: {done.stderr.strip()}")
    return done.stdout


def _has_result(job: Any) -> bool:
    """Return whether a job has written its result; a change of its folder's mode has NFS look again."""
    folder = job.paths.folder
    folder.chmod(folder.stat().st_mode)
    return bool(job.paths.result_pickle.exists())


def _cancel(submitted: Sequence[Any], paths: Sequence[Path], executor: str) -> None:
    """Ask jobs to stop, and wait a while until their runs are saved."""
    if executor == "slurm" and submitted:
        subprocess.run(["scancel", "--quiet", *(job.job_id for job in submitted)], check=False)
    for job in submitted if executor == "local" else []:
        if not job.done():  # its `cancel` kills within a second; SIGTERM is passed on to the run
            with suppress(ProcessLookupError):
                os.kill(int(job.job_id), signal.SIGTERM)
    deadline = time.monotonic() + GRACE_S + 1
    begun = paths[: len(submitted)]
    while time.monotonic() < deadline and (
        any(RunDirectory(path).under_way for path in begun)
        or (executor == "local" and any(not job.done() for job in submitted))
    ):
        time.sleep(POLL_S)


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Hold back SIGINT until the end of the block, and for good in processes that are started in it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _result(job: Any, executor: str) -> Any:
    """Return what a job returned, or the error that it ended with."""
    if not _has_result(job):
        by = "by Slurm" if executor == "slurm" else "from outside"
        return FailedRunError(f"stopped {by}; rerun the same command (log: {job.paths.stderr})")
    try:
        if (error := job.exception()) is None:
            return job.result()
    except Exception as problem:  # unpickling can raise anything; the other jobs' results are still returned
        return FailedRunError(f"cannot read {job.paths.result_pickle}: {str(problem) or type(problem).__name__}")
    trace = str(error).rpartition(RULE)[0] or str(error)  # what follows the last rule are paths of logs
    lines = [line.strip() for line in trace.splitlines() if line.strip(" -")]
    return FailedRunError(f"{lines[-1] if lines else type(error).__name__} (log: {job.paths.stderr})")

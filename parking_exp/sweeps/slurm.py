"""The slurm launcher: jobs of submitit on a Slurm cluster.

The end of a job is judged by `squeue` and by its run directory: without accounting, submitit does
not notice that a job was cancelled, ran out of time or lost its node.
"""

import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from parking_exp.config.paths import refuse_links
from parking_exp.errors import ConfigError, FailedRunError, first_line
from parking_exp.phrases import plural
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_state import read_state
from parking_exp.sweeps.local import valid_n_jobs
from parking_exp.sweeps.supervisor import GRACE_S, supervise_job
from parking_exp.terminal import say
from parking_exp.training.signals import stop_on_signal

POLL_S = 5.0


class SlurmLauncher:
    """Jobs on a cluster, whose nodes share the file system of the run directories.

    Args:
        n_jobs: the most jobs at a time; by default as many as the cluster takes.
        folder: the folder of submitit's files; None: `.submitit` in the output directory.
        parameters: arguments of submitit's `AutoExecutor.update_parameters`.

    Raises:
        ConfigError: submitit refuses the parameters, or finds no Slurm.
    """

    def __init__(
        self, n_jobs: int | None, folder: str | None, parameters: Mapping[str, Any]
    ) -> None:
        if not isinstance(parameters, Mapping):
            raise ConfigError(
                f"hydra.launcher.parameters={parameters} is not a mapping, {{KEY: VALUE}}"
            )
        if not isinstance(folder, str | None):
            raise ConfigError(f"hydra.launcher.folder={folder} is not a path")
        self.folder = Path(folder) if folder else None
        self.n_jobs = valid_n_jobs(n_jobs)
        self.parameters = {key: value for key, value in parameters.items() if value is not None}
        self._submitter(Path())  # before anything is on disk

    def train(self, paths: Sequence[Path]) -> str | None:
        """Train runs as jobs; return how many ended early, or None.

        Ctrl-C cancels the jobs, which save their states. Jobs continue if the launcher is killed,
        and a rerun leaves their runs alone.

        Raises:
            FailedRunError: a job cannot be submitted.
            UntrustedError: a link leads out of the output directory, to which submitit would write.
            InterruptedRunError: a signal stopped it.
        """
        submitter = self._submitter(self._submitit_folder(RunDirectory(paths[0]).output_dir))
        n_at_once = self.n_jobs or len(paths)
        waiting = list(paths)
        jobs: dict[Path, Any] = {}
        active: list[Any] = []
        # Jobs outlive a closed terminal.
        with stop_on_signal(signals=(signal.SIGINT, signal.SIGTERM)) as stop:
            try:
                while (waiting or active) and not stop.is_made:
                    while waiting and len(active) < n_at_once and not stop.is_made:
                        path = waiting.pop(0)
                        jobs[path] = _submit(submitter, path, active)
                    time.sleep(POLL_S)
                    active = _unfinished(active)
            finally:
                _cancel(active)
        stop.raise_if_made()
        return _early_ends(jobs)

    def _submitit_folder(self, output_dir: Path) -> Path:
        """Return the folder of submitit's files; an output directory may come from others."""
        if self.folder is not None:
            return self.folder
        folder = output_dir / ".submitit"
        refuse_links([folder, *folder.rglob("*")], output_dir)
        return folder

    def _submitter(self, folder: Path) -> Any:
        """Return submitit's executor, or raise ConfigError with its reason."""
        import submitit

        try:
            submitter = submitit.AutoExecutor(folder=folder / "%j", cluster="slurm")
            submitter.update_parameters(**self.parameters)
        except (NameError, TypeError, ValueError, AssertionError, RuntimeError) as error:
            raise ConfigError(f"hydra.launcher: {first_line(error)}") from error
        return submitter


def _submit(submitter: Any, path: Path, active: list[Any]) -> Any:
    """Submit the job of a run, add it to the active ones, and return it."""
    from submitit.core.utils import FailedJobError

    # Ctrl-C waits for `sbatch`, so that every submitted job is known, and cancelled.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        job = submitter.submit(supervise_job, path)
        active.append(job)
    except FailedJobError as error:
        reason = str(error).splitlines()[-1]
        raise FailedRunError(f"submitit cannot submit: {reason}") from error
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    return job


def _unfinished(jobs: list[Any]) -> list[Any]:
    """Return the jobs that are queued or running; all of them while `squeue` fails."""
    command = ["squeue", "--noheader", "--array", "--format=%i", f"--user={os.getuid()}"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    except (subprocess.SubprocessError, OSError) as error:  # e.g. the controller is restarting
        say(f"warning: {error}; trying again", stderr=True)
        return jobs
    listed = set(done.stdout.split())
    return [job for job in jobs if job.job_id in listed]


def _cancel(jobs: list[Any]) -> None:
    """Ask jobs to stop, and wait a while until their runs are saved."""
    if not jobs:
        return
    deadline = time.monotonic() + GRACE_S + 1
    subprocess.run(["scancel", "--quiet", *(job.job_id for job in jobs)], check=False)
    while jobs and time.monotonic() < deadline:
        jobs = _unfinished(jobs)
        if jobs:
            time.sleep(POLL_S)


def _early_ends(jobs: Mapping[Path, Any]) -> str | None:
    """Return how many jobs ended before their runs did, and the log of the first one, or None."""
    logs = [job.paths.stderr for path, job in jobs.items() if read_state(path).stage == "pending"]
    if not logs:
        return None
    number = f"{len(logs)} of {plural(len(jobs), 'job')}"
    return f"{number} ended early, stopped by Slurm or a signal; the first log: {logs[0]}"

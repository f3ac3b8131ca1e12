"""The slurm launcher: jobs of submitit, on a Slurm cluster or as processes of this machine.

The end of a job is judged by `squeue` and by its run directory: without accounting, submitit does
not notice that a job was cancelled, ran out of time or lost its node.
"""

import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from parking_exp.config.paths import refuse_links
from parking_exp.errors import ConfigError, FailedRunError, first_line, plural
from parking_exp.resources import cores
from parking_exp.runs.run_state import read_state
from parking_exp.sweeps.local import check_n_jobs
from parking_exp.sweeps.supervisor import GRACE_S, supervise_job
from parking_exp.terminal import say
from parking_exp.training.signals import stop_on_signal

POLL_S = {"local": 0.2, "slurm": 5.0}


class SlurmLauncher:
    """Jobs on a cluster, whose nodes share the file system of the run directories.

    Args:
        executor: `slurm`, or `local` for processes of this machine.
        n_jobs: how many at a time; None: as many as the cluster takes, or this machine has cores.
        folder: of submitit's files; None: `.submitit` in the output directory.
        parameters: of submitit's `AutoExecutor.update_parameters`.

    Raises:
        ConfigError: submitit refuses the parameters, or finds no Slurm.
    """

    def __init__(
        self, executor: str, n_jobs: int | None, folder: str | None, parameters: Mapping[str, Any]
    ) -> None:
        if not isinstance(parameters, Mapping):
            raise ConfigError(
                f"hydra.launcher.parameters={parameters} is not a mapping, {{KEY: VALUE}}"
            )
        if not isinstance(folder, str | None):
            raise ConfigError(f"hydra.launcher.folder={folder} is not a path")
        self.executor = executor
        self.folder = Path(folder) if folder else None
        self.n_jobs = check_n_jobs(n_jobs) or (len(cores()) if executor == "local" else None)
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
        from submitit.core.utils import FailedJobError

        output_dir = paths[0].parents[2]
        folder = self.folder
        if folder is None:
            folder = output_dir / ".submitit"
            refuse_links(
                [folder, *folder.rglob("*")], output_dir
            )  # the output directory may come from others
        submitter = self._submitter(folder)
        waiting, jobs, active = list(paths), dict[Path, Any](), list[Any]()
        with stop_on_signal(
            signals=(signal.SIGINT, signal.SIGTERM)
        ) as request:  # jobs outlive a closed terminal
            try:
                while (waiting or active) and not request.is_made:
                    while (
                        waiting
                        and len(active) < (self.n_jobs or len(paths))
                        and not request.is_made
                    ):
                        path = waiting.pop(0)
                        # Ctrl-C waits for `sbatch`, so that every submitted job is known, and
                        # cancelled.
                        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
                        try:
                            jobs[path] = submitter.submit(supervise_job, path)
                            active.append(jobs[path])
                        finally:
                            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
                    time.sleep(POLL_S[self.executor])
                    active = self._unfinished(active)
            except FailedJobError as error:
                raise FailedRunError(
                    f"submitit cannot submit: {str(error).splitlines()[-1]}"
                ) from error
            finally:
                self._cancel(active)
        request.raise_if_made()
        early = [
            job.paths.stderr for path, job in jobs.items() if read_state(path).stage == "pending"
        ]
        number = f"{len(early)} of {plural(len(jobs), 'job')}"
        return (
            f"{number} ended early, stopped by Slurm or a signal; the first log: {early[0]}"
            if early
            else None
        )

    def _submitter(self, folder: Path) -> Any:
        import submitit

        try:
            submitter = submitit.AutoExecutor(folder=folder / "%j", cluster=self.executor)
            submitter.update_parameters(**self.parameters)
        except (NameError, TypeError, ValueError, AssertionError, RuntimeError) as error:
            raise ConfigError(f"hydra.launcher: {first_line(error)}") from error
        return submitter

    def _unfinished(self, jobs: list[Any]) -> list[Any]:
        """Return the jobs that are queued or running; all of them while `squeue` fails."""
        if self.executor == "local":
            return [job for job in jobs if not job.done()]
        command = ["squeue", "--noheader", "--array", "--format=%i", f"--user={os.getuid()}"]
        try:
            listed = subprocess.run(
                command, capture_output=True, text=True, check=True, timeout=60
            ).stdout.split()
        except (
            subprocess.SubprocessError,
            OSError,
        ) as error:  # e.g. the controller is being restarted
            say(f"warning: {error}; trying again", stderr=True)
            return jobs
        return [job for job in jobs if job.job_id in listed]

    def _cancel(self, jobs: list[Any]) -> None:
        """Ask jobs to stop, and wait a while until their runs are saved."""
        if not jobs:
            return
        deadline = time.monotonic() + GRACE_S + 1
        if self.executor == "slurm":
            subprocess.run(["scancel", "--quiet", *(job.job_id for job in jobs)], check=False)
        for job in jobs if self.executor == "local" else ():  # its `cancel` kills within a second
            with suppress(ProcessLookupError):
                os.kill(int(job.job_id), signal.SIGTERM)
        while time.monotonic() < deadline and (jobs := self._unfinished(jobs)):
            time.sleep(POLL_S[self.executor])

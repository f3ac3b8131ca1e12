"""The launchers `local` and `slurm`. Hydra imports this module at each start: other imports wait for a launch."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class _JobLauncher(Launcher):
    """Base of both: a job is a run, `run=PATH`, or a worker of a search, `study=PATH n_trials=N storage=URI`."""

    def __init__(self, n_jobs: int | None) -> None:
        if n_jobs is not None and (type(n_jobs) is not int or n_jobs <= 0):
            from parking_exp.errors import ConfigError

            raise ConfigError(f"hydra.launcher.n_jobs={n_jobs} is not valid; give a number above 0, or null")
        self.n_jobs = n_jobs
        self.task: TaskFunction | None = None

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Keep the task, which is called with the config of a job."""
        self.task = task_function

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run the jobs; JobReturn.return_value says how a run ended."""
        parser, returns = OverridesParser.create(), []
        parsed = [parser.parse_overrides(list(overrides)) for overrides in job_overrides]
        values = self.run([DictConfig({each.key_or_group: each.value() for each in job}) for job in parsed])
        for overrides, value in zip(job_overrides, values, strict=True):
            status = JobStatus.FAILED if isinstance(value, Exception) else JobStatus.COMPLETED
            done = JobReturn(overrides=list(overrides), working_dir=str(Path.cwd()), status=status)
            done.return_value = value
            returns.append(done)
        return returns

    def run(self, jobs: Sequence[DictConfig]) -> Sequence[Any]:
        """Run jobs of one kind; return the value or the error of each."""
        raise NotImplementedError


class LocalLauncher(_JobLauncher):
    """Processes of this machine, with cores of their own; see `parking_exp.sweeps.local`."""

    def run(self, jobs: Sequence[DictConfig]) -> Sequence[Any]:
        """Train the runs of the jobs, or have as many workers as there are jobs train the trials of a search."""
        from parking_exp.sweeps.local import launch, launch_workers

        if "study" not in jobs[0]:
            results = launch([Path(job.run) for job in jobs], self.n_jobs)
            return [results.get(Path(job.run)) for job in jobs]
        from parking_exp.tuning.trial_worker import work

        folder, n_trials, storage = Path(jobs[0].study), jobs[0].n_trials, jobs[0].get("storage")
        launch_workers(lambda train: work(folder, n_trials, train, storage), len(jobs))
        return [None] * len(jobs)


class SlurmLauncher(_JobLauncher):
    """Jobs of a Slurm cluster, or processes of this machine, by submitit; see `parking_exp.sweeps.slurm.launch`."""

    def __init__(self, executor: str, n_jobs: int | None, folder: str | None, parameters: Mapping[str, Any]) -> None:
        from parking_exp.sweeps.slurm import make_executor

        super().__init__(n_jobs)
        make_executor(executor, Path(), parameters)  # refuses what is wrong before anything is on disk
        self.executor, self.folder, self.parameters = executor, folder, dict(parameters)

    def run(self, jobs: Sequence[DictConfig]) -> Sequence[Any]:
        """Call the task for each job, on the cluster."""
        from parking_exp.sweeps.slurm import launch

        output_dir = Path(jobs[0].study).parent if "study" in jobs[0] else Path(jobs[0].run).parents[2]
        folder = Path(self.folder) if self.folder else output_dir / ".submitit"
        assert self.task is not None
        return launch(self.task, jobs, self.executor, self.n_jobs, folder, self.parameters)

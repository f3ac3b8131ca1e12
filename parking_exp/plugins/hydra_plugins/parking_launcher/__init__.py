"""Launchers that Hydra finds: `hydra/launcher=local` and `hydra/launcher=slurm`.

Hydra imports every module here at each start: what they need is imported when they launch.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class _RunLauncher(Launcher):
    """Base of both launchers: a job is a run, `run=PATH`, or a search's worker, `study=PATH n_trials=N storage=URI`."""

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Do nothing: the task follows from the jobs."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Do the jobs; how a run ended is in JobReturn.return_value."""
        jobs = [_job(overrides) for overrides in job_overrides]
        if "study" in jobs[0]:
            results = self.search(Path(jobs[0]["study"]), jobs[0]["n_trials"], jobs[0].get("storage"), len(jobs))
        else:
            results = self.train([Path(job["run"]) for job in jobs])
        returns = []
        for overrides, result in zip(job_overrides, results, strict=True):
            done = JobReturn(overrides=list(overrides), working_dir=str(Path.cwd()), status=JobStatus.COMPLETED)
            done.return_value = result
            returns.append(done)
        return returns

    def train(self, paths: Sequence[Path]) -> Sequence[Any]:
        """Train the runs of these directories; return how each ended."""
        raise NotImplementedError

    def search(self, folder: Path, n_trials: int, storage: str | None, n_workers: int) -> Sequence[Any]:
        """Have so many workers train the first trials of a search."""
        raise NotImplementedError


class LocalLauncher(_RunLauncher):
    """Fresh processes side by side on this machine; see `parking_exp.sweeps.local.launch`."""

    def __init__(self, n_jobs: int | None) -> None:
        _check("n_jobs", n_jobs, int)
        self.n_jobs = n_jobs

    def train(self, paths: Sequence[Path]) -> Sequence[Any]:
        """Train the runs of these directories; return how each ended."""
        from parking_exp.sweeps.local import launch

        results = launch(paths, self.n_jobs)
        return [results.get(path) for path in paths]

    def search(self, folder: Path, n_trials: int, storage: str | None, n_workers: int) -> Sequence[Any]:
        """Have so many workers train the first trials of a search."""
        from parking_exp.sweeps.local import launch_workers
        from parking_exp.tuning.trial_worker import work

        launch_workers(lambda train: work(folder, n_trials, train, storage), n_workers)
        return [None] * n_workers


class SlurmLauncher(_RunLauncher):
    """Jobs of a Slurm cluster, or processes of this machine, by submitit; see `parking_exp.sweeps.slurm.launch`."""

    def __init__(self, executor: str, n_jobs: int | None, folder: str | None, parameters: Mapping[str, Any]) -> None:
        from parking_exp.sweeps.slurm import make_executor

        make_executor(executor, Path(), parameters)  # refuses what is wrong before anything is on disk
        _check("n_jobs", n_jobs, int)
        self.executor, self.n_jobs, self.folder, self.parameters = executor, n_jobs, folder, dict(parameters)

    def train(self, paths: Sequence[Path]) -> Sequence[Any]:
        """Train the runs of these directories; return how each ended."""
        from parking_exp.sweeps.supervisor import supervise_job

        return self._launch(supervise_job, paths, paths[0].parents[2])

    def search(self, folder: Path, n_trials: int, storage: str | None, n_workers: int) -> Sequence[Any]:
        """Have so many workers train the first trials of a search."""
        from parking_exp.tuning.trial_worker import work_job

        job = partial(work_job, n_trials=n_trials, storage=storage)
        return self._launch(job, [folder] * n_workers, folder.parent)

    def _launch(self, task: Callable[[str], Any], paths: Sequence[Path], output_dir: Path) -> Sequence[Any]:
        from parking_exp.sweeps.slurm import launch

        folder = Path(self.folder) if self.folder else output_dir / ".submitit"
        return launch(task, paths, self.executor, self.n_jobs, folder, self.parameters)


def _check(name: str, value: Any, kind: Any) -> None:
    """Refuse a value that is neither null nor a number above 0."""
    if value is not None and (not isinstance(value, kind) or isinstance(value, bool) or value <= 0):
        from parking_exp.errors import ConfigError

        raise ConfigError(f"hydra.launcher.{name}={value} is not valid; give a number above 0, or null")


def _job(overrides: Sequence[str]) -> dict[str, Any]:
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    job = {override.key_or_group: override.value() for override in parsed}
    if not {"run", "study"} & job.keys():
        raise ValueError(f"this launcher trains run directories, and {list(overrides)} has no run=PATH")
    return job

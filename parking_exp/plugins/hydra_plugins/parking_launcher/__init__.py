"""Launchers that Hydra finds: `hydra/launcher=local` and `hydra/launcher=slurm`.

Hydra imports every module here at each start: what they need is imported when they launch.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import JobReturn, JobStatus
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig


class _RunLauncher(Launcher):
    """Base of both launchers: a job is a run directory, `run=PATH`; only a WorkerResult is returned."""

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Do nothing: the task is always `parking_exp.sweeps.supervisor.supervise`."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Train the runs and return how each ended, in JobReturn.return_value."""
        paths = [Path(_run_of(overrides)) for overrides in job_overrides]
        results = self.train(paths)
        returns = []
        for overrides, path in zip(job_overrides, paths, strict=True):
            done = JobReturn(overrides=list(overrides), working_dir=str(Path.cwd()), status=JobStatus.COMPLETED)
            done.return_value = results.get(path)
            returns.append(done)
        return returns

    def train(self, paths: Sequence[Path]) -> Mapping[Path, Any]:
        """Train the runs of these directories."""
        raise NotImplementedError


class LocalLauncher(_RunLauncher):
    """Fresh processes side by side on this machine; see `parking_exp.sweeps.local.launch`."""

    def __init__(self, n_jobs: int | None, memory_gb: float | None) -> None:
        _check("n_jobs", n_jobs, int)
        _check("memory_gb", memory_gb, int | float)
        self.n_jobs, self.memory_gb = n_jobs, memory_gb

    def train(self, paths: Sequence[Path]) -> Mapping[Path, Any]:
        """Train the runs of these directories."""
        from parking_exp.sweeps.local import launch

        return launch(paths, self.n_jobs, self.memory_gb)


class SlurmLauncher(_RunLauncher):
    """Jobs of a Slurm cluster, or processes of this machine, by submitit; see `parking_exp.sweeps.slurm.launch`."""

    def __init__(self, executor: str, n_jobs: int | None, folder: str | None, parameters: Mapping[str, Any]) -> None:
        from parking_exp.sweeps.slurm import check

        check(executor)
        _check("n_jobs", n_jobs, int)
        self.executor, self.n_jobs, self.folder, self.parameters = executor, n_jobs, folder, dict(parameters)

    def train(self, paths: Sequence[Path]) -> Mapping[Path, Any]:
        """Train the runs of these directories."""
        from parking_exp.sweeps.slurm import launch

        return launch(paths, self.executor, self.n_jobs, Path(self.folder) if self.folder else None, self.parameters)


def _check(name: str, value: Any, kind: Any) -> None:
    """Refuse a value that is neither null nor a number above 0."""
    if value is not None and (not isinstance(value, kind) or isinstance(value, bool) or value <= 0):
        from parking_exp.errors import ConfigError

        raise ConfigError(f"hydra.launcher.{name}={value} is not valid; give a number above 0, or null")


def _run_of(overrides: Sequence[str]) -> str:
    for override in OverridesParser.create().parse_overrides(list(overrides)):
        if override.key_or_group == "run":
            return str(override.value())
    raise ValueError(f"this launcher trains run directories, and {list(overrides)} has no run=PATH")

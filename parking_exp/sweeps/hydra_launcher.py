"""Set up the Hydra launcher of a command line, and have it train run directories."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.experimental.callback import Callback
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig

from parking_exp.config.compose import hydra_ready, user_options
from parking_exp.config.overrides import hydra_overrides
from parking_exp.errors import ConfigError, ParkingError, plural
from parking_exp.resources import cores
from parking_exp.sweeps.supervisor import WorkerResult, stop_of_job, supervise

EXTRAS = {"slurm", "ray"}


class Launch:
    """A Hydra launcher, as the command line sets it up: its name and `hydra.launcher`.

    Any launcher works: each job of a sweep has one override, `run=PATH`. A search has jobs and a task of its own.
    """

    def __init__(
        self,
        overrides: list[str],
        extra_config_dir: str | None = None,
        task: Callable[[DictConfig], object] | None = None,
    ) -> None:
        with hydra_ready():
            loader = GlobalHydra.instance().config_loader()
            config = loader.load_configuration(
                "worker", [*user_options(extra_config_dir), *hydra_overrides(overrides)], RunMode.MULTIRUN
            )
            self.config: DictConfig = config.hydra.launcher
            self.name: str = config.hydra.runtime.choices["hydra/launcher"]
            # Launchers notify the context's callbacks of each job; a plain `Callback` does nothing.
            context = HydraContext(config_loader=loader, callbacks=cast(Any, Callback()))
            try:
                self._launcher = Plugins.instance().instantiate_launcher(context, task or train_run, config)
            except (ImportError, RuntimeError) as error:
                raise self._unusable(error) from error

    @property
    def n_jobs(self) -> int | None:
        """Number of jobs at a time; None if unknown."""
        if self.name == "basic":
            return 1
        return self.config.get("n_jobs") or (len(cores()) if self.name == "local" else None)

    def jobs(self, overrides: Sequence[Sequence[str]]) -> tuple[list[Any], str | None]:
        """Run jobs, each with its own overrides.

        Returns:
            What each job returned or raised, empty if the launcher itself broke; and what broke, or None.
        """
        with hydra_ready():
            try:
                values = [_value_of(job) for job in self._launcher.launch(overrides, 0)]
            except ImportError as error:
                raise self._unusable(error) from error
            except ParkingError:
                raise
            except Exception as error:  # of a third party; the run directories have the states of the runs
                return [], f"hydra/launcher={self.name} broke: {_first_line(error).rstrip('.')}"
        if not (errors := [value for value in values if isinstance(value, Exception)]):
            return values, None
        return values, f"{len(errors)} of {plural(len(values), 'job')} ended early; the first: {errors[0]}"

    def _unusable(self, error: Exception) -> ConfigError:
        extra = f"; pip install 'parking-exp[{self.name}]'" if self.name in EXTRAS else ""
        return ConfigError(f"hydra/launcher={self.name}: {_first_line(error)}{extra}")


def train_run(config: DictConfig) -> WorkerResult:
    """Train the run of a directory, as a job of any launcher; Hydra's task function.

    Raises:
        KeyboardInterrupt: a signal to the job stopped it; the run's state is saved.
    """
    with stop_of_job() as stop:
        return supervise(Path(config.run), stop)


def _value_of(job: JobReturn) -> Any:
    """Return what a job returned, or the exception that it raised."""
    try:
        return job.return_value
    except Exception as error:
        return error


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]

"""Set up the Hydra launcher of a command line, and have it train run directories."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.types import HydraContext, RunMode
from omegaconf import DictConfig

from parking_exp.config.compose import hydra_ready
from parking_exp.config.overrides import hydra_overrides, in_quotes
from parking_exp.errors import ConfigError, ParkingError, did_you_mean, plural, suggestion
from parking_exp.sweeps.supervisor import WorkerResult, supervise_job

EXTRAS = {"slurm", "ray"}


class Launch:
    """A launcher of Hydra's, set up as the command line says.

    Any launcher will do: it is given one override a job, `run=PATH`, and a task that trains what lies there; a search
    gives it jobs of its own, `study=PATH n_trials=N [storage=URI]`, and another task.

    Raises:
        ConfigError: the launcher is not installed, or its config is wrong.

    Attributes:
        name: the launcher's, `hydra/launcher`.
        config: its own config, `hydra.launcher`.
    """

    def __init__(
        self,
        overrides: list[str],
        extra_config_dir: str | None = None,
        task: Callable[[DictConfig], object] | None = None,
    ) -> None:
        self._overrides, self._extra = hydra_overrides(overrides), extra_config_dir
        with hydra_ready(self._extra):
            loader = GlobalHydra.instance().config_loader()
            _refuse_unknown_keys(self._overrides)
            whole = loader.load_configuration("worker", self._overrides, RunMode.MULTIRUN)
            self.config: DictConfig = whole.hydra.launcher
            self.name: str = whole.hydra.runtime.choices["hydra/launcher"]
            context = HydraContext(config_loader=loader, callbacks=Callbacks(whole))
            try:
                self._launcher = Plugins.instance().instantiate_launcher(context, task or train_run, whole)
            except (ImportError, RuntimeError) as error:
                words = str(error).splitlines()[0]
                raise ConfigError(f"hydra/launcher={self.name}: {words}{_extra_of(self.name)}") from error

    def __call__(self, paths: Sequence[Path]) -> tuple[dict[Path, WorkerResult], str | None]:
        """Train the runs of these directories.

        Returns:
            How each run ended, where the launcher returns that, and what broke in the launcher itself, or None.

        Raises:
            ConfigError: a package is missing.
            InterruptedRunError: a signal stopped it.
        """
        returns, problem = self.jobs([[f"run={in_quotes(str(path))}"] for path in paths])
        # Not strict: a launcher that broke has returned nothing.
        values = dict(zip(paths, returns, strict=False))
        return {path: value for path, value in values.items() if value in get_args(WorkerResult)}, problem

    def jobs(self, overrides: Sequence[Sequence[str]]) -> tuple[list[Any], str | None]:
        """Run jobs, each with overrides of its own.

        Returns:
            What each has returned or raised; none where the launcher itself broke. And what broke, or None.

        Raises:
            ConfigError: a package is missing.
            InterruptedRunError: a signal stopped it.
        """
        with hydra_ready(self._extra):
            try:
                returns = self._launcher.launch(overrides, 0)
            except ImportError as error:
                raise ConfigError(f"hydra/launcher={self.name}: {error}{_extra_of(self.name)}") from error
            except ParkingError:
                raise
            except Exception as error:  # a launcher may break in any way; run directories tell what became of the runs
                words = (str(error) or type(error).__name__).splitlines()[0]
                hint = "; `ray start --head` starts one here" if "running Ray instance" in words else ""
                return [], f"hydra/launcher={self.name} broke: {words.rstrip('.')}{hint}"
        values = [one._return_value for one in returns]  # not `return_value`: that raises what a job has raised
        broken = [value for value in values if isinstance(value, BaseException)]
        return (
            values,
            f"{len(broken)} of {plural(len(values), 'job')} ended early; the first: {broken[0]}" if broken else None,
        )


def _refuse_unknown_keys(overrides: list[str]) -> None:
    """Refuse a key that the chosen launcher does not have.

    Raises:
        ConfigError: with the closest one.
    """
    typed = [override for override in overrides if override.startswith("hydra.launcher.")]
    if not typed:
        return
    chosen = [override for override in overrides if override.lstrip("+~").startswith("hydra/launcher")]
    whole = GlobalHydra.instance().config_loader().load_configuration("worker", chosen, RunMode.MULTIRUN)
    name = whole.hydra.runtime.choices["hydra/launcher"]
    for override in typed:
        key = override.partition("=")[0]
        node: object = whole.hydra.launcher
        for part in key.split(".")[2:]:
            if isinstance(node, DictConfig) and part not in node:
                known = [str(one) for one in node if one != "_target_"]
                if node is whole.hydra.launcher:
                    hint = suggestion(part, known)
                else:  # `parameters`, `ray.init` and the like take every key of their library
                    close = did_you_mean(part, known, cutoff=0.8)
                    hint = f"{close} If not, add it:" if close else "; to add it, write"
                    hint += f" +{override}"
                raise ConfigError(f"{key}: hydra/launcher={name} has no such key{hint}")
            node = node[part] if isinstance(node, DictConfig) else None


def train_run(config: DictConfig) -> WorkerResult:
    """Hydra's task function: train the run of a directory."""
    return supervise_job(config.run)


def _extra_of(launcher: str) -> str:
    return f"; pip install 'parking-exp[{launcher}]'" if launcher in EXTRAS else ""

"""The launcher of a command line, `hydra/launcher=NAME`: one of ours, or a plugin of Hydra."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol, cast

from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.core.utils import JobStatus
from hydra.experimental.callback import Callback
from hydra.plugins.launcher import Launcher as Plugin
from hydra.types import HydraContext, RunMode
from hydra.utils import get_class
from omegaconf import DictConfig, OmegaConf

from parking_exp.config.compose import hydra_ready, user_options
from parking_exp.config.overrides import hydra_overrides, in_quotes
from parking_exp.errors import ConfigError, first_line, plural
from parking_exp.sweeps.local import LocalLauncher
from parking_exp.sweeps.supervisor import supervise_job

EXTRAS = {"slurm", "ray"}


class Launcher(Protocol):
    """Trains run directories, each in a process of its own."""

    def train(self, paths: Sequence[Path]) -> str | None:
        """Train runs until they are over or interrupted; return an error of the launcher itself, or None."""


def launcher_of(overrides: list[str], extra_config_dir: str | None = None) -> Launcher:
    """Return the launcher that a command line names, with its settings checked.

    Raises:
        ConfigError: it is unknown, not installed, or set up wrongly.
    """
    with hydra_ready():
        loader = GlobalHydra.instance().config_loader()
        lines = [*user_options(extra_config_dir), *hydra_overrides(overrides)]
        config = loader.load_configuration("worker", lines, RunMode.MULTIRUN)
        name, settings = config.hydra.runtime.choices["hydra/launcher"], config.hydra.launcher
        if name == "basic":  # Hydra's own
            return LocalLauncher(1)
        try:
            if settings._target_.startswith("parking_exp."):
                keywords = cast(dict[str, Any], OmegaConf.to_container(settings, resolve=True))
                return get_class(keywords.pop("_target_"))(**keywords)
            # Launchers notify the context's callbacks of each job; a plain `Callback` does nothing.
            context = HydraContext(config_loader=loader, callbacks=cast(Any, Callback()))
            return PluginLauncher(name, Plugins.instance().instantiate_launcher(context, _train, config))
        except (ImportError, RuntimeError, TypeError) as error:
            raise _unusable(name, error) from error


class PluginLauncher:
    """A third-party launcher, a Hydra plugin; each of its jobs has one override, `run=PATH`."""

    def __init__(self, name: str, plugin: Plugin) -> None:
        self.name, self._plugin = name, plugin

    def train(self, paths: Sequence[Path]) -> str | None:
        """Train runs as jobs of the plugin; return what broke, or how many jobs ended early."""
        with hydra_ready():
            try:
                jobs = self._plugin.launch([[f"run={in_quotes(str(path))}"] for path in paths], 0)
            except ImportError as error:
                raise _unusable(self.name, error) from error
            except Exception as error:  # the run directories have the states of the runs
                return f"hydra/launcher={self.name} broke: {first_line(error).rstrip('.')}"
        n_early = sum(job.status is not JobStatus.COMPLETED for job in jobs)
        return f"{n_early} of {plural(len(jobs), 'job')} ended early" if n_early else None


def _train(config: DictConfig) -> None:
    """Train the run of a directory; Hydra's task function."""
    supervise_job(Path(config.run))


def _unusable(name: str, error: Exception) -> ConfigError:
    extra = f"; pip install 'parking-exp[{name}]'" if name in EXTRAS and not isinstance(error, TypeError) else ""
    return ConfigError(f"hydra/launcher={name}: {first_line(error)}{extra}")

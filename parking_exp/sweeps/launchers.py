"""The launcher of a command line, `hydra/launcher=NAME`: one of ours, or a plugin of Hydra."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, cast

from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.core.utils import JobStatus
from hydra.experimental.callback import Callback
from hydra.plugins.launcher import Launcher as Plugin
from hydra.types import HydraContext, RunMode
from hydra.utils import get_class
from omegaconf import DictConfig, open_dict

from parking_exp.config.compose import ComposedCell, hydra_ready, user_options
from parking_exp.config.overrides import in_quotes
from parking_exp.errors import ConfigError, first_line
from parking_exp.phrases import plural
from parking_exp.sweeps.local import LocalLauncher
from parking_exp.sweeps.supervisor import supervise_job

EXTRAS = {"slurm", "ray"}


class Launcher(Protocol):
    """Trains run directories, each in a process of its own."""

    def train(self, paths: Sequence[Path]) -> str | None:
        """Train runs until they are over or interrupted; return an error of the launcher itself, or
        None.
        """


def make_launcher(
    cells: Sequence[ComposedCell], extra_config_dir: str | None = None, *, connect: bool = False
) -> Launcher:
    """Make the launcher that a command line or its experiment file names, with checked settings.

    Args:
        cells: the cells of one sweep.
        extra_config_dir: Hydra's `--config-dir`.
        connect: whether to connect to the cluster now, before anything is on disk.

    Raises:
        ConfigError: it is unknown, not installed, set up wrongly or out of reach, or experiments
            name different ones.
    """
    name = cells[0].launcher
    settings = cells[0].launcher_settings
    if any((cell.launcher, cell.launcher_settings) != (name, settings) for cell in cells):
        raise ConfigError(
            "these experiments have different launchers; name one with hydra/launcher=NAME"
        )
    if name == "basic":  # Hydra's own
        return LocalLauncher(1)
    with hydra_ready():
        try:
            launcher_class: Any = get_class(settings["_target_"])
            if not issubclass(launcher_class, Plugin):
                return _plain_launcher(launcher_class, settings)
            if connect and name == "ray":
                _connect_to_ray(settings)
            return _plugin_launcher(name, settings, extra_config_dir)
        except (ImportError, RuntimeError, TypeError) as error:
            raise _unusable(name, error) from error


def _plain_launcher(launcher_class: Any, settings: Mapping[str, Any]) -> Launcher:
    """Return a launcher of this package, or of a user's, that is not a plugin of Hydra."""
    arguments = dict(settings)
    del arguments["_target_"]
    return launcher_class(**arguments)


def _plugin_launcher(
    name: str, settings: Mapping[str, Any], extra_config_dir: str | None
) -> "PluginLauncher":
    """Return a launcher that is a plugin of Hydra, made by Hydra from its settings."""
    loader = GlobalHydra.instance().config_loader()
    overrides = [*user_options(extra_config_dir), f"hydra/launcher={name}"]
    config = loader.load_configuration("worker", overrides, RunMode.MULTIRUN)
    with open_dict(config):
        config.hydra.launcher = settings
    # Launchers notify the context's callbacks of each job; a plain `Callback` does nothing.
    context = HydraContext(config_loader=loader, callbacks=cast(Any, Callback()))
    plugin = Plugins.instance().instantiate_launcher(context, _supervise_task, config)
    return PluginLauncher(name, plugin)


def _connect_to_ray(settings: Mapping[str, Any]) -> None:
    """Connect to the running cluster; the plugin uses this connection."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # where `init` starts a cluster
    import ray

    try:
        ray.init(**settings["ray"]["init"])
    except (ConnectionError, RuntimeError, ValueError) as error:
        reason = first_line(error).partition(". ")[0]
        raise ConfigError(
            f"hydra/launcher=ray: {reason}; start a cluster with `ray start --head`"
        ) from error


class PluginLauncher:
    """A third-party launcher, a Hydra plugin; each of its jobs has one override, `run=PATH`."""

    def __init__(self, name: str, plugin: Plugin) -> None:
        self.name = name
        self._plugin = plugin

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


def _supervise_task(config: DictConfig) -> None:
    """Supervise the run of a directory; Hydra's task function."""
    supervise_job(Path(config.run))


def _unusable(name: str, error: Exception) -> ConfigError:
    extra = ""
    if name in EXTRAS and not isinstance(error, TypeError):
        extra = f"; pip install 'parking-exp[{name}]'"
    return ConfigError(f"hydra/launcher={name}: {first_line(error)}{extra}")

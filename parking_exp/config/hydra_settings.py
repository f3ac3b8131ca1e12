"""Hydra's own settings, of which only the launcher's are read: others are refused."""

from typing import Any

from omegaconf import DictConfig, OmegaConf

from parking_exp.config.settings import flatten_config
from parking_exp.errors import ConfigError

# Prefixes of keys that are not refused: Hydra itself sets them, or they change neither files nor
# runs.
ACCEPTED: tuple[str, ...] = (
    "help.",
    "job.config_name",
    "job.override_dirname",
    "mode",
    "overrides.",
    "runtime.",
    "searchpath",
)
OUTPUT = "set output_dir=DIR and experiment_name=NAME"
# What to type instead, by the prefix of the key; the first prefix that fits counts.
INSTEAD = {
    "launcher.": "this command launches no runs; leave it out",
    "sweeper.": (
        "list the values on the command line, KEY=1,2, or as cells: [{KEY: [1, 2]}] in an "
        "experiment file"
    ),
    "job.env_set.": "set environment variables in the shell, before the command",
    "job.chdir": "start the command in that directory, or set output_dir=DIR",
    "run.": OUTPUT,
    "sweep.": OUTPUT,
    "output_subdir": OUTPUT,
    "": "of Hydra's own settings only hydra/launcher and its keys are read",
}


def check_hydra_settings(composed: DictConfig, ours: DictConfig, *, launches_runs: bool) -> None:
    """Refuse settings that are not read, unless our own files set them.

    Raises:
        ConfigError: with what to type instead.
    """
    accepted = (*ACCEPTED, "launcher.") if launches_runs else ACCEPTED
    default = _settings(ours)
    for key, value in _settings(composed).items():
        if value == default.get(key) or key.startswith(accepted):
            continue
        raise ConfigError(f"hydra.{key}={value} has no effect; {what_instead(key)}")


def what_instead(key: str) -> str:
    """Return what to type instead of a key of `hydra` that is not read."""
    return next(words for prefix, words in INSTEAD.items() if key.startswith(prefix))


def _settings(node: DictConfig) -> dict[str, Any]:
    plain: Any = OmegaConf.to_container(node)
    return flatten_config(plain)

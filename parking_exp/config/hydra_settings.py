"""Hydra's own settings, of which only the launcher's are read: others are refused."""

import re
from collections.abc import Iterable
from typing import Any

from omegaconf import DictConfig, OmegaConf

from parking_exp.config.settings import settings_of
from parking_exp.errors import ConfigError

# Set by Hydra itself, or without effect on files and runs; `launcher` for the commands that launch
# runs.
READ = (
    "help",
    "job.config_name",
    "job.override_dirname",
    "mode",
    "overrides",
    "runtime",
    "searchpath",
)
LAUNCHING = ("config", "tune")
INSTEAD = {
    "launcher": "this command launches no runs; leave it out",
    "sweeper": (
        "list the values on the command line, KEY=1,2, or as cells: [{KEY: [1, 2]}] in an "
        "experiment file"
    ),
    "job.env_set": "set environment variables in the shell, before the command",
    "job.chdir": "start the command in that directory, or set output_dir=DIR",
    **dict.fromkeys(
        ("run", "sweep", "output_subdir"), "set output_dir=DIR and experiment_name=NAME"
    ),
}


def check_hydra_overrides(config_name: str, overrides: Iterable[str]) -> None:
    """Refuse overrides of a command line that set what is not read.

    Raises:
        ConfigError: with what to type instead.
    """
    for override in overrides:
        key = re.sub(r"^[+~]*hydra[./]?", "", override.partition("=")[0]).replace("/", ".")
        _check(config_name, key, override)


def check_hydra_settings(config_name: str, composed: DictConfig, plain: DictConfig) -> None:
    """Refuse settings of composed files that are not read, unless ours set them.

    Raises as `check_hydra_overrides`.
    """
    given = _settings(composed)
    ours = _settings(plain)
    for key in {**given, **ours}:
        if given.get(key) != ours.get(key):
            _check(config_name, key, f"hydra.{key}={given.get(key)}")


def _check(config_name: str, key: str, setting: str) -> None:
    if _is_part(key, READ) or (config_name in LAUNCHING and _is_part(key, ("launcher",))):
        return
    instead = "of Hydra's own settings only hydra/launcher and its keys are read"
    for part, words in INSTEAD.items():
        if _is_part(key, (part,)):
            instead = words
    raise ConfigError(f"{setting} has no effect; {instead}")


def _settings(node: DictConfig) -> dict[str, Any]:
    plain: Any = OmegaConf.to_container(node)
    return settings_of(plain)


def _is_part(key: str, sections: tuple[str, ...]) -> bool:
    return f"{key}.".startswith(tuple(f"{section}." for section in sections))

"""Sentences for the errors of Hydra and OmegaConf, with a hint at what was meant."""

from typing import Any

import yaml
from hydra.errors import MissingConfigException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    KeyValidationError,
    OmegaConfBaseException,
)

from parking_exp.config.constructor_arguments import argument_hint
from parking_exp.config.hydra_settings import what_instead
from parking_exp.config.overrides import conf_dir
from parking_exp.config.settings import flatten_config
from parking_exp.errors import first_line, one_line
from parking_exp.phrases import suggestion


def explain(error: Exception) -> str:
    """Return an error of Hydra, OmegaConf or YAML as one line, with hints at unknown names."""
    if isinstance(error, OverrideParseException):
        return (
            f"{error.override}: can't be parsed; write KEY=VALUE, KEY=[1,2] for a list, \"KEY='a "
            "(b)'\" for text"
        )
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        group, _, option = str(error.missing_cfg_file).rpartition("/")
        return f"{group}={option}: there is no such option{suggestion(option, error.options or [])}"
    cause = error if isinstance(error, OmegaConfBaseException) else error.__cause__
    if isinstance(cause, ConfigKeyError | ConfigAttributeError) and cause.parent_node is not None:
        return _unknown_key(cause)
    if any(isinstance(item, KeyValidationError) for item in (cause, error.__context__)):
        return "a config file has a key that is null or not a word; write it in quotes, as 'null'"
    if isinstance(cause, OmegaConfBaseException) and cause.full_key:
        return f"{cause.full_key}: {first_line(cause)}"
    return one_line(error)


def _unknown_key(error: ConfigKeyError | ConfigAttributeError) -> str:
    """Name an unknown key, and the closest one of its section."""
    key = str(error.full_key)
    name = str(error.key)
    section = key.rpartition(".")[0]
    if key.startswith("hydra.") and not key.startswith("hydra.launcher."):
        return f"{key} has no effect; {what_instead(key.removeprefix('hydra.'))}"
    known: Any = error.parent_node
    if isinstance(known, DictConfig):
        known = OmegaConf.to_container(known)
    if not isinstance(known, dict):
        return f"{key}: {section} has no keys"
    inner = _section_with(name, known)
    if inner is not None:  # a section was left out
        meant = ".".join(part for part in (section, inner, name) if part)
        hint = f"; did you mean {meant!r}?"
    elif "_target_" in known:
        hint = argument_hint(key, known, _hint_at_options(section, name))
    elif not known:  # takes other keys, too
        hint = f"; write ++{key}=VALUE to add it"
    else:
        hint = _hint_at_options(section, name) or suggestion(name, known)
    option = f" in {section}={known['name']}" if section and "name" in known else ""
    return f"{key}: there is no such key{option}{hint}"


def _section_with(name: str, known: dict[str, Any]) -> str | None:
    """Return the inner section that has a key; None if there is none."""
    for path in flatten_config(known):
        parts = path.split(".")
        if name in parts[1:]:
            return ".".join(parts[: parts.index(name, 1)])
    return None


def _hint_at_options(group: str, name: str) -> str:
    """Name options of a group that have a key; empty if there are none."""
    options = []
    for file in sorted((conf_dir() / group).glob("*.yaml")):
        keys = yaml.safe_load(file.read_text()) or {}
        if group and name in keys:
            options.append(file.stem)
    if not options:
        return ""
    return f"; use it only with options that have it, such as {group}={','.join(options)}"

"""Validate a config: types, ranges, rules between keys, then arguments of third-party classes.

Every error is one sentence that names the key and what is wrong. Our own keys are checked without
importing torch or mlflow; the third-party classes, and torch with them, are imported after that.
"""

from collections.abc import Iterable, Mapping, Set
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from pydantic import BaseModel, ValidationError

from parking_exp.config.constructor_arguments import argument_problems
from parking_exp.config.rules import rule_problems, task_problems
from parking_exp.config.schema import RunConfig, SweepOptions
from parking_exp.errors import ConfigError, first_line, reason_of_invalid_value
from parking_exp.phrases import did_you_mean
from parking_exp.tasks.registry import TASKS

Model = TypeVar("Model", bound=BaseModel)
# omegaconf puts this before the message of a ConfigError.
RESOLVER_PREFIX = "ConfigError raised while resolving interpolation: "
Config = DictConfig | Mapping[str, Any]

# Keys that define a sweep, not a run.
SWEEP_KEYS = {"seeds", "cells", *SweepOptions.model_fields}
MAX_ERRORS = 5


def raise_problems(problems: Iterable[str]) -> None:
    """Raise ConfigError with the first five problems, if there are any."""
    distinct = list(dict.fromkeys(problems))  # cells of a sweep may share one
    if distinct:
        raise ConfigError("\n".join(distinct[:MAX_ERRORS]))


def validate(config: Config | RunConfig) -> RunConfig:
    """Validate a composed config.

    Raises:
        ConfigError: with one sentence for each of the first five things that are wrong.
    """
    return config if isinstance(config, RunConfig) else validate_all([config])[0]


def validate_all(configs: Iterable[Config]) -> list[RunConfig]:
    """Validate configs: our keys of all, then the arguments of classes.

    Raises:
        ConfigError: see `validate`.
    """
    runs = []
    for config in configs:
        runs.append(parse_config(RunConfig, config, without=SWEEP_KEYS))
        raise_problems(rule_problems(runs[-1]))
    raise_problems(task_problems(runs))
    for run in runs:
        raise_problems(argument_problems(run))
    return runs


def parse_config(model: type[Model], config: Config, without: Set[str] = frozenset()) -> Model:
    """Resolve the interpolations of a config, and check all keys but some against a schema.

    Raises:
        ConfigError: see `validate`.
    """
    try:
        node = config if isinstance(config, DictConfig) else OmegaConf.create(dict(config))
        plain: Any = OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except MissingMandatoryValue as error:
        raise ConfigError(f"{error.full_key} is missing") from error
    except OmegaConfBaseException as error:
        reason = first_line(error)
        if reason.startswith(RESOLVER_PREFIX):  # its message names the key
            raise ConfigError(reason.removeprefix(RESOLVER_PREFIX)) from error
        raise ConfigError(f"{error.full_key}: {reason}") from error
    return parse_plain(model, {key: value for key, value in plain.items() if key not in without})


def parse_plain(model: type[Model], plain: Mapping[str, Any]) -> Model:
    """Check plain values against a schema, and return them as its model.

    Raises:
        ConfigError: see `validate`.
    """
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        raise_problems(_sentence_of_pydantic(item, model) for item in error.errors())
        raise


def _sentence_of_pydantic(error: Any, model: type[BaseModel]) -> str:
    """Say what is wrong with a value: an item of `ValidationError.errors()`."""
    # Pydantic adds the task to keys of `env`.
    key = ".".join(str(part) for part in error["loc"] if part not in TASKS)
    reason = reason_of_invalid_value(error)
    match error["type"]:
        case "missing":
            return f"{key} is missing"
        case "extra_forbidden":
            name = str(error["loc"][-1])
            schema = model.model_json_schema()
            known: set[str] = set()
            for part in (schema, *schema.get("$defs", {}).values()):
                known.update(part.get("properties", ()))
            return f"{key}: there is no such key{did_you_mean(name, known - {name})}"
        case "string_type" if isinstance(error["input"], int | float):
            return f"{key}={error['input']!r} is not text; put it in quotes, \"{key}='...'\""
        case "task":
            return f"{key}.task: {reason}"
        case "value_error":  # the message of one of our validators; the value may be a password
            return f"{key}: {reason}"
    return f"{key}={error['input']!r}: {reason}"

"""Validate a config: types and ranges, third-party arguments, rules between keys.

Every complaint is one sentence that names the key, what is wrong and the closest valid choice. Nothing here imports
torch or mlflow: a typo is refused in well under two seconds.
"""

import math
from collections.abc import Iterator, Mapping, Set
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from pydantic import BaseModel, ValidationError

from parking_exp.config.constructor_arguments import check_arguments
from parking_exp.config.credentials import keep_password
from parking_exp.config.messages import LARGEST_NUMBER, NUMBER_RANGE, sentence
from parking_exp.config.rules import check_rules
from parking_exp.config.schema import RunConfig, SweepOptions
from parking_exp.errors import ConfigError

Model = TypeVar("Model", bound=BaseModel)

# Keys of a composed config that say which runs there are, and nothing about any of them.
SWEEP_KEYS = {"seeds", "cells", *SweepOptions.model_fields}


def validate(config: DictConfig | Mapping[str, Any] | RunConfig) -> RunConfig:
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with one sentence for each of the first five things that are wrong.
    """
    if isinstance(config, RunConfig):
        return config
    run = parse(RunConfig, config, without=SWEEP_KEYS)
    problems = check_arguments(run) or check_rules(run)
    if problems:
        raise ConfigError("\n".join(problems[:5]))
    return run


def parse(model: type[Model], config: DictConfig | Mapping[str, Any], without: Set[str] = frozenset()) -> Model:
    """Resolve interpolations and check a config, less some keys, against a schema.

    Raises:
        ConfigError: it doesn't fit.
    """
    try:
        node = config if isinstance(config, DictConfig) else OmegaConf.create(dict(config))
        plain: Any = OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except MissingMandatoryValue as error:
        raise ConfigError(f"{error.full_key} is missing") from error
    except OmegaConfBaseException as error:
        raise ConfigError(f"{error.full_key}: {str(error).splitlines()[0]}") from error
    tracking = plain.get("tracking")
    if isinstance(tracking, dict) and isinstance(uri := tracking.get("uri"), str):
        keep_password(uri)  # the schema drops it
    return check(model, {key: value for key, value in plain.items() if key not in without})


def check(model: type[Model], plain: Mapping[str, Any]) -> Model:
    """Check plain values against a schema.

    Raises:
        ConfigError: they don't fit.
    """
    if problems := list(_bad_numbers(plain)):
        raise ConfigError("\n".join(problems[:5]))
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        raise ConfigError("\n".join(sentence(item, model) for item in error.errors()[:5])) from error


def _bad_numbers(value: object, key: str = "") -> Iterator[str]:
    """Yield a sentence for each number in nested containers that is not finite or too large to compute with."""
    if isinstance(value, float) and not math.isfinite(value):
        yield f"{key}={value}: input should be a finite number"
    elif isinstance(value, int | float) and abs(value) > LARGEST_NUMBER:
        yield f"{key} is out of range; {NUMBER_RANGE}"
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for name, item in items:
        yield from _bad_numbers(item, f"{key}.{name}" if key else str(name))

"""Validate a config: types, ranges and rules between keys, then the arguments of third-party classes.

Every error is one sentence that names the key and what is wrong. Our own keys are checked without importing torch or
mlflow; the third-party classes, and torch with them, are imported after that.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Set
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from pydantic import BaseModel, ValidationError

from parking_exp.config.constructor_arguments import check_arguments
from parking_exp.config.credentials import keep_password
from parking_exp.config.messages import keys_at, sentence
from parking_exp.config.rules import check_rules, check_tasks
from parking_exp.config.schema import RunConfig, SweepOptions
from parking_exp.errors import ConfigError

Model = TypeVar("Model", bound=BaseModel)
Config = DictConfig | Mapping[str, Any]

# Keys that define a sweep, not a run.
SWEEP_KEYS = {"seeds", "cells", *SweepOptions.model_fields}
LARGEST_NUMBER = 1e15  # of any key: its square is a float, and its digits can be printed
MOST_ERRORS = 5


def refuse(problems: Iterable[str]) -> None:
    """Refuse a config that has problems.

    Raises:
        ConfigError: with the first five of them.
    """
    if first := list(itertools.islice(problems, MOST_ERRORS)):
        raise ConfigError("\n".join(first))


def validate(config: Config | RunConfig) -> RunConfig:
    """Validate a composed config.

    Raises:
        ConfigError: with one sentence for each of the first five things that are wrong.
    """
    return config if isinstance(config, RunConfig) else validate_all([config])[0]


def validate_all(configs: Iterable[Config]) -> list[RunConfig]:
    """Validate composed configs: our own keys of all, then the arguments of their classes; raises as `validate`."""
    runs = []
    for config in configs:
        runs.append(parse(RunConfig, config, without=SWEEP_KEYS))
        refuse(check_rules(runs[-1]))
    refuse(check_tasks(runs))
    for run in runs:
        refuse(check_arguments(run))
    return runs


def parse(model: type[Model], config: Config, without: Set[str] = frozenset()) -> Model:
    """Resolve interpolations and check a config, less some keys, against a schema; raises as `validate`."""
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
    """Check plain values against a schema; raises as `validate`."""
    refuse(_bad_numbers(plain))
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        refuse(sentence(item, choices=keys_at(model, item["loc"][:-1])) for item in error.errors())
        raise


def _bad_numbers(value: object, key: str = "") -> Iterator[str]:
    """Yield a sentence for each number in nested containers that is not finite or too large to compute with."""
    if isinstance(value, float) and not math.isfinite(value):
        yield f"{key}={value} is not a finite number"
    elif isinstance(value, int | float) and abs(value) > LARGEST_NUMBER:
        yield f"{key} is out of range: numbers are at most {LARGEST_NUMBER:.0e}"
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for name, item in items:
        yield from _bad_numbers(item, f"{key}.{name}" if key else str(name))

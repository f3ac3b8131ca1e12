"""The space of a search: its dimensions as Optuna's distributions, and the values of trials."""

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from parking_exp.tuning.search_config import Dimension, SearchConfig

if TYPE_CHECKING:
    from optuna import Trial

DIGITS = 6  # of sampled numbers: configs stay readable


def parameter(key: str, dimension: Dimension) -> str:
    """Return the name under which Optuna knows a dimension: its key, or `1 - KEY`."""
    return f"1 - {key}" if dimension.one_minus_log else key


def suggest(trial: "Trial", name: str, dimension: Dimension) -> Any:
    """Return a trial's parameter for a dimension, sampled if it has none; choices are JSON texts."""
    low, high = dimension.bounds
    if dimension.choices is not None:
        return trial.suggest_categorical(name, [json.dumps(choice) for choice in dimension.choices])
    if dimension.whole:
        return trial.suggest_int(name, int(low), int(high))
    if dimension.one_minus_log:
        return trial.suggest_float(name, _rounded(1 - high), _rounded(1 - low), log=True)
    return trial.suggest_float(name, low, high, log=dimension.log is not None)


def to_parameter(dimension: Dimension, value: Any) -> Any:
    """Return a config's value as Optuna's parameter, or None if it is outside the dimension."""
    if dimension.choices is not None:
        same = (c for c in dimension.choices if c == value and isinstance(c, bool) == isinstance(value, bool))
        return next(map(json.dumps, same), None)
    if isinstance(value, bool) or not isinstance(value, int | float) or (dimension.whole and value != int(value)):
        return None
    low, high = dimension.bounds
    if not low <= value <= high:
        return None
    if dimension.one_minus_log:
        return _rounded(1 - value)
    return int(value) if dimension.whole else float(value)


def to_value(dimension: Dimension, parameter: Any) -> Any:
    """Return Optuna's parameter as a config's value."""
    if dimension.choices is not None:
        return json.loads(parameter)
    if dimension.whole:
        return int(parameter)
    return _rounded(1 - parameter if dimension.one_minus_log else parameter)


def applies(dimension: Dimension, chosen: Mapping[str, Any]) -> bool:
    """Return whether a dimension is sampled with these values of other keys."""
    return all(chosen.get(key) in values for key, values in dimension.when.items())


def in_order(search: SearchConfig) -> list[tuple[str, Dimension]]:
    """Return the dimensions, each after those that its `when` names; groups first, since they define other keys.

    Raises:
        ValueError: their conditions are circular.
    """
    waiting = sorted(search.space.items(), key=lambda item: "." in item[0])
    found: dict[str, Dimension] = {}
    while waiting:
        ready = [item for item in waiting if item[1].when.keys() <= found.keys()]
        if not ready:
            raise ValueError(f"search.space.{waiting[0][0]}.when: it depends on itself through other conditions")
        found |= dict(ready)
        waiting = [item for item in waiting if item[0] not in found]
    return list(found.items())


def base_value(base: DictConfig, groups: Mapping[str, str], key: str) -> Any:
    """Return the value of a key, or the chosen option of a group, in the base config."""
    if key in groups:
        return groups[key]
    node = OmegaConf.select(base, key.lstrip("+"))
    return OmegaConf.to_container(node, resolve=True) if OmegaConf.is_config(node) else node


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else value

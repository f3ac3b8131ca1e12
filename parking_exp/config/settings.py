"""Configs as flat dotted keys: flatten, write and read values, compare, fill in defaults."""

import json
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from pydantic import BaseModel

from parking_exp.config.run_key import changes_results
from parking_exp.config.schema import BufferConfig
from parking_exp.tasks.registry import ENV_CONFIGS

Setting = str | int | float | bool | None
FlatConfig = Mapping[str, Setting]
"""Dotted keys -> values of one cell."""


def flatten_config(config: Mapping[str, Any], prefix: str = "") -> dict[str, Setting]:
    """Return a nested config as settings by dotted keys; lists become text, as in stores."""
    flat: dict[str, Setting] = {}
    for key, value in config.items():
        if isinstance(value, Mapping) and value:
            flat |= flatten_config(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = str(value) if isinstance(value, list | dict) else value
    return flat


def encode_setting(value: Setting) -> str:
    """Return a setting as text, for stores and tables; `decode_setting` is its inverse.

    A text that would be read as anything else is in double quotes.
    """
    if isinstance(value, str) and decode_setting(value) != value:
        return json.dumps(value, ensure_ascii=False)
    return str(value)


def decode_setting(text: str | None) -> Setting:
    """Return a text as a setting: None, a bool, a number or text; lists and mappings stay text."""
    if text is None or text == "None":
        return None
    if text in ("True", "False"):
        return text == "True"
    if text.startswith('"'):
        with suppress(ValueError):  # it only begins with a quotation mark
            return str(json.loads(text))
    for number in (int, float):
        try:
            return number(text) if "_" not in text else text  # 2024_11 is a name
        except ValueError:
            continue
    return text


def yaml_text(value: object) -> str:
    """Write a scalar or a list as YAML and Hydra's command line read it."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{','.join(map(yaml_text, value))}]"
    return str(value)


def display_setting(value: Any) -> str:
    """Write a config value as YAML would, numbers with six digits."""
    return f"{value:.6g}" if isinstance(value, float) else yaml_text(value)


def hashable(value: Setting) -> Hashable:
    """Return a setting as a key of a dict, where True and 1 differ."""
    return (isinstance(value, bool), value)


def distinguishes_cells(key: str) -> bool:
    """Return whether a key can make two cells differ: it changes results, and is not the seed."""
    return key != "seed" and changes_results(key)


def differing_keys(configs: Sequence[FlatConfig]) -> list[str]:
    """Return the keys that can change a result and differ between configs."""
    differing = []
    for key in sorted(set().union(*configs)):
        values = {hashable(config.get(key)) for config in configs}
        if distinguishes_cells(key) and len(values) > 1:
            differing.append(key)
    return differing


def with_defaults(config: FlatConfig) -> dict[str, Setting]:
    """Return a config with the defaults of the keys that stored configs leave out."""
    complete: dict[str, Setting] = {}
    if "buffer.name" in config:
        complete |= _defaults_left_out(BufferConfig, "buffer.")
    task = config.get("env.task")
    if task in ENV_CONFIGS:
        complete |= _defaults_left_out(ENV_CONFIGS[task], "env.")
    complete |= config
    return complete


def _defaults_left_out(model: type[BaseModel], prefix: str) -> dict[str, Setting]:
    """Return the defaults of a section's keys that stored configs leave out, as dotted keys."""
    defaults: dict[str, Setting] = {}
    for name, field in model.model_fields.items():
        key = f"{prefix}{name}"
        if field.exclude_if is not None and field.default is not None:
            defaults |= flatten_config({key: field.default})
        elif isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            defaults |= _defaults_left_out(field.annotation, f"{key}.")
    return defaults

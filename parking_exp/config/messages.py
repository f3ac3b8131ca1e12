"""Error messages for what pydantic refuses."""

import itertools
import re
from collections.abc import Iterable
from typing import Any, get_args

from pydantic import BaseModel, TypeAdapter, ValidationError

from parking_exp.errors import ConfigError, suggestion

MOST_ERRORS = 5


def refuse(problems: Iterable[str]) -> None:
    """Refuse a config that has problems.

    Raises:
        ConfigError: with the first five of them.
    """
    if first := list(itertools.islice(problems, MOST_ERRORS)):
        raise ConfigError("\n".join(first))


def problems_of(valid: Any, value: object, key: str) -> list[str]:
    """Return what is wrong with the value of a key, given the type that it must have: one sentence, or none."""
    try:
        TypeAdapter(valid).validate_python(value, strict=True)
    except ValidationError as error:
        items = error.errors()
        if len(items) == 1:
            return [sentence(items[0], prefix=key)]
        return [f"{key}={value!r}: {' or '.join(_lower(item['msg']) for item in items)}"]  # of a union
    return []


def sentence(error: Any, model: type[BaseModel] | None = None, prefix: str = "") -> str:
    """Say what pydantic complains about: an item of `ValidationError.errors()`, of a section or of the key `prefix`."""
    parts, value = [str(part) for part in error["loc"]], error["input"]
    key = ".".join([*([prefix] if prefix else []), *parts])
    match error["type"]:
        case "extra_forbidden":
            return f"{key}: there is no such key{suggestion(parts[-1], _keys(model, parts[:-1]))}"
        case "missing":
            return f"{key} is missing"
        case "model_type":
            return f"{key}={value!r} is not a group of keys"
        case "literal_error":
            choices = re.findall(r"'([^']*)'", error["ctx"]["expected"])
            return f"{key}={value} is not a valid choice{suggestion(str(value), choices)}"
    return f"{key}={value!r}: {_lower(error['msg'])}"


def _lower(message: str) -> str:
    message = message.removeprefix("Value error, ")
    return message[0].lower() + message[1:]


def _keys(model: type[BaseModel] | None, path: list[str]) -> list[str]:
    """Return the keys of the section at a path."""
    for part in path:
        if model is not None and part in model.model_fields:  # otherwise the name of a section in a mapping of them
            annotation = model.model_fields[part].annotation
            types = [t for t in (annotation, *get_args(annotation)) if isinstance(t, type)]
            model = next((t for t in types if issubclass(t, BaseModel)), model)
    return [field.alias or name for name, field in model.model_fields.items()] if model else []

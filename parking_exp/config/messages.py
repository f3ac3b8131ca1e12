"""Error messages for what pydantic refuses."""

import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from parking_exp.errors import ConfigError, suggestion

MOST_ERRORS = 5


def refuse(problems: Iterable[str]) -> None:
    """Refuse a config that has problems.

    Raises:
        ConfigError: with the first five of them.
    """
    if first := list(itertools.islice(problems, MOST_ERRORS)):
        raise ConfigError("\n".join(first))


def problems_of(model: type[BaseModel], values: Mapping[str, Any], key: str, choices: Iterable[str]) -> Iterator[str]:
    """Yield what is wrong with the values in a section, given its model and its keys."""
    try:
        model.model_validate(values)
    except ValidationError as error:
        for (name,), group in itertools.groupby(error.errors(), lambda item: item["loc"][:1]):
            items = list(group)
            if len(items) > 1:  # of a union
                yield f"{key}.{name}={values[str(name)]!r}: {' or '.join(_lower(item['msg']) for item in items)}"
            else:
                yield sentence(items[0], choices, f"{key}.")


def sentence(error: Any, choices: Iterable[str], prefix: str = "") -> str:
    """Say what pydantic complains about: an item of `ValidationError.errors()`, of a section with some keys."""
    parts, value = [str(part) for part in error["loc"]], error["input"]
    key = prefix + ".".join(parts)
    match error["type"]:
        case "extra_forbidden":
            return f"{key}: there is no such key{suggestion(parts[-1], choices)}"
        case "missing":
            return f"{key} is missing"
        case "model_type":
            return f"{key}={value!r} is not a group of keys"
        case "literal_error":
            options = re.findall(r"'([^']*)'", error["ctx"]["expected"])
            return f"{key}={value} is not a valid choice{suggestion(str(value), options)}"
    return f"{key}={value!r}: {_lower(error['msg'])}"


def _lower(message: str) -> str:
    message = message.removeprefix("Value error, ")
    return message[0].lower() + message[1:]


def keys_at(model: type[BaseModel], path: Sequence[int | str]) -> list[str]:
    """Return the keys of the section at a path."""
    for part in path:
        if part in model.model_fields:  # otherwise the name of a section in a mapping of them
            annotation = model.model_fields[str(part)].annotation
            types = [t for t in (annotation, *get_args(annotation)) if isinstance(t, type)]
            model = next((t for t in types if issubclass(t, BaseModel)), model)
    return [field.alias or name for name, field in model.model_fields.items()]

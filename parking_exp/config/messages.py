"""One-sentence messages for values that pydantic refuses."""

import re
from collections.abc import Iterable, Sequence
from typing import Any, get_args

from pydantic import BaseModel

from parking_exp.errors import suggestion
from parking_exp.tasks.env_config import TASKS


def sentence(error: Any, section: str = "", choices: Iterable[str] = ()) -> str:
    """Say what is wrong with a value: an item of `ValidationError.errors()`, of a section with some keys."""
    key = ".".join([*filter(None, [section]), *map(str, without_tag(error["loc"]))])
    value = error["input"]
    match error["type"]:
        case "extra_forbidden":
            return unknown_key(key, choices)
        case "union_tag_not_found":
            return f"{key}.task is missing"
        case "union_tag_invalid":
            return f"{key}.task={error['ctx']['tag']} is not a valid choice{suggestion(error['ctx']['tag'], TASKS)}"
        case "missing":
            return f"{key} is missing"
        case "model_type":
            return f"{key}={value!r} is not a group of keys"
        case "literal_error":
            options = re.findall(r"'([^']*)'", error["ctx"]["expected"])
            return f"{key}={value} is not a valid choice{suggestion(str(value), options)}"
    return f"{key}={value!r}: {reason(error)}"


def without_tag(path: Sequence[int | str]) -> Sequence[int | str]:
    """Return the path of a key without the name of the task, which pydantic adds: `env.parking.duration`."""
    return [*path[:1], *path[2:]] if path[:1] == ("env",) and path[1:2] and path[1] in TASKS else path


def reason(error: Any) -> str:
    """Return pydantic's message within a sentence."""
    message = error["msg"].removeprefix("Value error, ")
    return message[0].lower() + message[1:]


def unknown_key(key: str, choices: Iterable[str]) -> str:
    """Say that a key does not exist, and which one may be meant."""
    return f"{key}: there is no such key{suggestion(key.rpartition('.')[2], choices)}"


def keys_at(model: type[BaseModel], path: Sequence[int | str]) -> list[str]:
    """Return the keys of the section at a path."""
    for part in path:
        if part in model.model_fields:  # otherwise the name of a section in a mapping of them, or of a task
            annotation = model.model_fields[str(part)].annotation
            sections = [t for t in (annotation, *get_args(annotation)) if isinstance(t, type)]
            model = next((t for t in sections if issubclass(t, BaseModel) and _is_of(t, path)), model)
    return [field.alias or name for name, field in model.model_fields.items()]


def _is_of(section: type[BaseModel], path: Sequence[int | str]) -> bool:
    """Return whether a section is that of the task which a path names, if it names one."""
    tasks = get_args(section.model_fields["task"].annotation) if "task" in section.model_fields else path
    return any(task in path for task in tasks)

"""Error messages for what pydantic refuses."""

from typing import Any, get_args, get_origin

from pydantic import BaseModel, TypeAdapter, ValidationError

from parking_exp.errors import suggestion

LARGEST_NUMBER = 1e15  # of any key: its square is a float, and its digits can be printed
NUMBER_RANGE = f"numbers lie between {-LARGEST_NUMBER:.0e} and {LARGEST_NUMBER:.0e}"


def problems_of(valid: Any, value: object, key: str) -> list[str]:
    """Return what is wrong with the value of a key, given the type that it must have."""
    try:
        TypeAdapter(valid).validate_python(value, strict=True)
    except ValidationError as error:
        return [sentence(item, prefix=key) for item in error.errors()]
    return []


def sentence(item: Any, model: type[BaseModel] | None = None, prefix: str = "") -> str:
    """Say what pydantic complains about: an item of `ValidationError.errors()`, of a section or of the key `prefix`."""
    parts = [str(part) for part in item["loc"] if part != "nullable"]
    key = ".".join([*([prefix] if prefix else []), *parts])
    context, value = item.get("ctx", {}), item["input"]
    match item["type"]:
        case "extra_forbidden":
            return f"{key}: there is no such key{suggestion(parts[-1], _keys(model, parts[:-1]))}"
        case "missing":
            return f"{key} is missing"
        case "greater_than_equal":
            return f"{key}={value} is out of range; the closest valid choice is {context['ge']}"
        case "less_than_equal":
            return f"{key}={value} is out of range; the closest valid choice is {context['le']}"
        case "less_than" if isinstance(context["lt"], float):
            return f"{key}={value} is out of range; it must be less than {context['lt']}"
        case "less_than":
            return f"{key}={value} is out of range; the closest valid choice is {context['lt'] - 1}"
        case "greater_than":
            return f"{key}={value} is out of range; it must be greater than {context['gt']}"
        case "literal_error":
            choices = [part.strip().strip("'") for part in context["expected"].replace(" or ", ", ").split(", ")]
            hint = suggestion(str(value), choices) if len(choices) > 1 else f"; it can only be {choices[0]}"
            return f"{key}={value} is not a valid choice{hint}"
        case "model_type":
            return f"{key}={value!r} is not a group of keys; it holds {', '.join(_keys(model, parts))}"
        case "string_pattern_mismatch" if parts == ["device"]:
            return f"device={value!r} is not a valid choice; choose from cpu, auto, cuda, cuda:N"
        case "string_pattern_mismatch":
            return f"{key}={value!r} is not valid; it must match {context['pattern']}"
        case "value_error":  # of a validator of ours, whose words name what is wrong
            return f"{key} {context['error']}"
    problem = item["msg"][0].lower() + item["msg"][1:]
    return f"{key}={value!r}: {problem}"


def _keys(model: type[BaseModel] | None, path: list[str]) -> list[str]:
    """Keys of the (nested) section at a path."""
    node: Any = model
    for part in path:
        if get_origin(node) is dict:  # of sections by name
            node = get_args(node)[1]
        else:
            field = node.model_fields.get(part) if _is_section(node) else None
            node = field.annotation if field else None
    return [field.alias or name for name, field in node.model_fields.items()] if _is_section(node) else []


def _is_section(node: Any) -> bool:
    return isinstance(node, type) and issubclass(node, BaseModel)

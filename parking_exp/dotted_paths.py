"""Import what the config names by a dotted path."""

from importlib import import_module
from typing import Any

from parking_exp.errors import ConfigError, class_and_message


def import_object(path: str, setting: str = "") -> Any:
    """Import the object at a dotted path, such as a class or a function.

    Args:
        path: the path of the object: its module, a dot and its name.
        setting: the setting that names it, with which the message of an error begins.

    Raises:
        ConfigError: it does not exist, or its module cannot be imported.
    """
    prefix = f"{setting}: " if setting else ""
    module, _, name = str(path).rpartition(".")
    if not module:
        raise ConfigError(f"{prefix}give a dotted path, MODULE.NAME")
    try:
        return getattr(import_module(module), name)
    except Exception as error:  # whatever a module does when it is imported
        extra = "; pip install 'parking-exp[contrib]'" if module.startswith("sb3_contrib") else ""
        raise ConfigError(f"{prefix}{class_and_message(error)}{extra}") from error

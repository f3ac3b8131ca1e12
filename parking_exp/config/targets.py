"""Find classes by their dotted paths."""

import pkgutil
import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from parking_exp.errors import suggestion

# Arguments that are classes, and the base that these must have. In a config they are dotted paths, or `_target_` nodes.
CLASS_ARGUMENTS = {
    "activation_fn": "torch.nn.Module",
    "optimizer_class": "torch.optim.Optimizer",
    "features_extractor_class": "stable_baselines3.common.torch_layers.BaseFeaturesExtractor",
}
CLASS_LOOKUPS = ("hydra.utils.get_class", "hydra.utils.get_object")


class UnknownTarget(LookupError):
    """A dotted path that names nothing that can be imported; the message says why."""


def find(target: object) -> Any:
    """Import the class or function at a dotted path.

    Raises:
        UnknownTarget: there is none, or its module cannot be imported.
    """
    if not isinstance(target, str) or "." not in target or not all(part.isidentifier() for part in target.split(".")):
        raise UnknownTarget("is not a dotted path, PACKAGE.MODULE.CLASS")
    path, _, name = target.rpartition(".")
    if path == "__main__":
        raise UnknownTarget("__main__ is a script, not a module; put the class into a module of its own")
    try:
        module = import_module(path)
    except Exception as error:  # whatever a module does when it is imported
        raise UnknownTarget(_import_problem(path, error)) from error
    if not hasattr(module, name):
        raise UnknownTarget(f"there is no {name!r} in {path}{suggestion(name, _public_names(module))}")
    return getattr(module, name)


def class_path(value: object) -> object:
    """Return the dotted path that a class argument names: itself, that of its `_target_`, or what that looks up."""
    if not isinstance(value, Mapping):
        return value
    is_lookup = value.get("_target_") in CLASS_LOOKUPS and "_args_" not in value
    return value.get("path" if is_lookup else "_target_")


def _import_problem(path: str, error: Exception) -> str:
    missing = error.name if isinstance(error, ModuleNotFoundError) else None
    if missing is None or not f"{path}.".startswith(f"{missing}."):
        return f"{path} cannot be imported: {type(error).__name__}: {error}".splitlines()[0]
    parent, _, name = missing.rpartition(".")
    if not parent:
        extra = "; pip install 'parking-exp[contrib]'" if name == "sb3_contrib" else ""
        return f"the package {name!r} is not installed{extra}"
    modules = pkgutil.iter_modules(getattr(sys.modules[parent], "__path__", []))
    return f"there is no module {name!r} in {parent}{suggestion(name, (one.name for one in modules))}"


def _public_names(module: object) -> list[str]:
    return [name for name in vars(module) if not name.startswith("_")]

"""Constructor signatures of third-party classes, read from their source.

A dotted path is followed through re-exports to the class, and through its bases to the first `__init__`. Nothing is
imported, as `inspect.signature` would need: to read `stable_baselines3.SAC` takes 7 ms of CPU time, to import it 3 s,
and a typo in a config is to be refused within two seconds.
"""

import ast
import builtins
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from parking_exp.config.source_lookup import class_of, definition_of, lineage, module_name, parent_of, resolve_base

SIMPLE_TYPES: dict[str, tuple[type, ...]] = {
    "int": (int,),
    "float": (int, float),
    "bool": (bool,),
    "str": (str,),
    "None": (type(None),),
}


# Annotations of what a YAML scalar can't be.
OBJECT_TYPES = re.compile(r"(tuple|list|dict|type|Sequence|Mapping|Callable)\b.*|Schedule|ActionNoise|np\.ndarray")

# Bases without Python source that derive from no class of any library.
PLAIN_BASES = {*vars(builtins), "ABC", "abc.ABC", "Generic", "typing.Generic", "Protocol", "typing.Protocol"}


@dataclass(frozen=True)
class Parameter:
    """One constructor parameter: its name, its annotation as written, and whether it has a default."""

    name: str
    annotation: str | None
    required: bool

    def accepts(self, value: object) -> bool:
        """Whether a YAML value fits the annotation, as far as its names are known: `int | None`, `float | Schedule`."""
        if self.annotation is None:
            return True
        parts = [part.strip().strip("\"'") for part in self.annotation.split("|")]
        if not all(part in SIMPLE_TYPES or OBJECT_TYPES.fullmatch(part) for part in parts):
            return True
        if isinstance(value, bool) or value is None:
            return type(value).__name__.replace("NoneType", "None") in parts
        if isinstance(value, int | float | str):
            return any(isinstance(value, SIMPLE_TYPES[part]) for part in parts if part in SIMPLE_TYPES)
        kinds = ("tuple", "list", "Sequence", "np.ndarray") if isinstance(value, list) else ("dict", "Mapping")
        return any(part.startswith(kinds) for part in parts)


@dataclass(frozen=True)
class Signature:
    """What a constructor takes. `open` says that it also takes any other keyword (`**kwargs`)."""

    parameters: dict[str, Parameter]
    open: bool

    def takes(self, name: str) -> bool:
        """Whether an argument may be given."""
        return self.open or name in self.parameters


@cache
def signature(target: str) -> Signature:
    """Return what the constructor (or function) at a dotted path takes, e.g. `stable_baselines3.SAC`.

    Raises:
        UnknownTarget: no such package, module or class, or one without Python source.
    """
    definition, home = definition_of(target)
    if isinstance(definition, ast.FunctionDef):
        return _signature(definition, is_method=False)
    constructor = _constructor(definition, home, target)
    # No source for any `__init__`: nothing can be said, so anything passes here.
    return _signature(constructor, is_method=True) if constructor else Signature({}, open=True)


def defined_in(target: str) -> str:
    """Return the dotted name of the module in which the class at a dotted path is defined.

    Raises:
        UnknownTarget: it names nothing, or no class.
    """
    return ".".join(module_name(class_of(target)[1]))


def base_names(target: str) -> set[str]:
    """Return the names of the class at a dotted path and of its bases, as far as their source can be read.

    Raises:
        UnknownTarget: it names nothing, or no class.
    """
    return {node.name for node, _ in lineage(*class_of(target), target)}


def may_derive_from(target: str, base: str) -> bool:
    """Whether the class at a dotted path has a base of some name. One that can't be read may be any.

    Raises:
        UnknownTarget: it names nothing, or no class.
    """
    found = list(lineage(*class_of(target), target))
    unread = (
        ast.unparse(written).partition("[")[0]
        for node, path in found
        for written in node.bases
        if parent_of(written, path, target) is None
    )
    return base in {node.name for node, _ in found} or not PLAIN_BASES.issuperset(unread)


def policy_signature(target: str, alias: str) -> Signature | None:
    """Return what the policy takes that an algorithm has under a name in its `policy_aliases`.

    None where the source does not say which it is.

    Raises:
        UnknownTarget: `target` names nothing, or no class.
    """
    for node, path in lineage(*class_of(target), target):
        for item in node.body:
            if not isinstance(item, ast.Assign | ast.AnnAssign) or not isinstance(item.value, ast.Dict):
                continue
            names = item.targets if isinstance(item, ast.Assign) else [item.target]
            if "policy_aliases" not in map(ast.unparse, names):
                continue
            for key, value in zip(item.value.keys, item.value.values, strict=True):
                if isinstance(key, ast.Constant) and key.value == alias:
                    policy, home = resolve_base(ast.unparse(value), path, target)
                    found = _constructor(policy, home, target) if isinstance(policy, ast.ClassDef) else None
                    return _signature(found, is_method=True) if found else None
    return None


def _constructor(node: ast.ClassDef, path: Path, target: str) -> ast.FunctionDef | None:
    for one, _ in lineage(node, path, target):
        for item in one.body:
            if isinstance(item, ast.FunctionDef) and item.name == "__init__":
                return item
    return None


def _signature(node: ast.FunctionDef, is_method: bool) -> Signature:
    arguments = node.args
    positional = [*arguments.posonlyargs, *arguments.args]
    required = len(positional) - len(arguments.defaults)
    parameters = {
        item.arg: Parameter(item.arg, _annotation(item), index < required) for index, item in enumerate(positional)
    }
    if is_method:
        parameters.pop(positional[0].arg)
    for item, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
        parameters[item.arg] = Parameter(item.arg, _annotation(item), default is None)
    return Signature(parameters, open=arguments.kwarg is not None)


def _annotation(argument: ast.arg) -> str | None:
    return ast.unparse(argument.annotation) if argument.annotation else None

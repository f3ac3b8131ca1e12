"""Find the definitions of classes and functions in Python source, without importing anything."""

import ast
import importlib.util
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path


class UnknownTarget(LookupError):
    """A dotted path that names nothing; `known` are the names that stand beside it."""

    def __init__(self, target: str, reason: str, known: list[str]) -> None:
        super().__init__(f"{target}: {reason}")
        self.reason = reason
        self.known = known


def class_of(target: str) -> tuple[ast.ClassDef, Path]:
    """Find where the class at a dotted path is defined.

    Raises:
        UnknownTarget: it names nothing, or no class.
    """
    definition, home = definition_of(target)
    if not isinstance(definition, ast.ClassDef):
        raise UnknownTarget(target, "is not a class", [])
    return definition, home


def definition_of(target: str) -> "Home":
    """Find where the class or function at a dotted path is defined."""
    module, _, name = target.rpartition(".") if isinstance(target, str) else ("", "", "")
    if not module or not all(part.isidentifier() for part in target.split(".")):
        raise UnknownTarget(str(target), "is not a dotted path, PACKAGE.MODULE.CLASS", [])
    return _resolve(_source(module, target), name, target)


def _source(module: str, target: str) -> Path:
    """Find the source file of a module without importing its parents (which would import torch)."""
    first, *rest = module.split(".")
    file, folders = _package(first, target)
    for name in rest:
        places = [folder / name for folder in folders]
        files = [file for place in places for file in (place / "__init__.py", place.with_suffix(".py"))]
        found = next((file for file in files if file.is_file()), None)
        namespace = [place for place in places if place.is_dir()]
        if found is None and not namespace:
            raise UnknownTarget(target, f"there is no module {name!r} in {first}", _modules(folders))
        file, folders = found, namespace if found is None else [found.parent] * (found.name == "__init__.py")
        first = f"{first}.{name}"
    if file is None or file.suffix != ".py" or not file.is_file():  # built in, frozen, compiled, or a namespace
        raise UnknownTarget(target, f"{module} has no Python source to read its signature from", _modules(folders))
    return file


def _package(name: str, target: str) -> tuple[Path | None, list[Path]]:
    """Return the source file of a top-level module, and where its submodules are; nothing is imported."""
    if name == "__main__":
        raise UnknownTarget(target, "__main__ is a script, not a module; put the class into a module of its own", [])
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):  # a module that was put together at run time
        spec = None
    if spec is None:
        raise UnknownTarget(target, f"the package {name!r} is not installed", [])
    return Path(spec.origin) if spec.origin else None, [Path(place) for place in spec.submodule_search_locations or []]


def _modules(folders: list[Path]) -> list[str]:
    """Return the names of modules and packages in some folders."""
    paths = [path for folder in folders for path in folder.iterdir()]
    return sorted({p.stem for p in paths if p.stem[0] != "_" and (p.suffix == ".py" or (p / "__init__.py").exists())})


@cache
def _tree(path: Path) -> ast.Module:
    try:
        return ast.parse(path.read_bytes())
    except (OSError, SyntaxError, ValueError) as error:
        raise UnknownTarget(str(path), f"{path} is not valid Python: {error}", []) from error


def module_name(path: Path) -> list[str]:
    """Dotted name of a source file, as parts, from the packages above it."""
    parts = [] if path.name == "__init__.py" else [path.stem]
    folder = path.parent
    while (folder / "__init__.py").exists():
        parts.insert(0, folder.name)
        folder = folder.parent
    return parts


Definition = ast.ClassDef | ast.FunctionDef
Home = tuple[Definition, Path]  # and the file where it stands


def _resolve(path: Path, name: str, target: str, seen: frozenset[tuple[Path, str]] = frozenset()) -> Home:
    """Follow re-exports from a module to the file where a name is defined; `seen` is where it has not been found."""
    if (path, name) in seen:  # `from package import module` in the package itself
        raise _unknown(path, name, target)
    seen |= {(path, name)}
    stars = []
    for node in _top_level(_tree(path)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return node, path
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if (alias.asname or alias.name) == name:
                    return _resolve(_source(_imported_module(node, path), target), alias.name, target, seen)
                if alias.name == "*":
                    stars.append(_imported_module(node, path))
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Name):
            names = [item.id for item in node.targets if isinstance(item, ast.Name)]
            if name in names and node.value.id != name:
                return _resolve(path, node.value.id, target, seen)
    for module in stars:
        with suppress(UnknownTarget):
            return _resolve(_source(module, target), name, target, seen)
    raise _unknown(path, name, target)


def _unknown(path: Path, name: str, target: str) -> UnknownTarget:
    return UnknownTarget(target, f"there is no {name!r} in {'.'.join(module_name(path))}", _names(path))


def _imported_module(node: ast.ImportFrom, path: Path) -> str:
    if not node.level:
        return node.module or ""
    package = module_name(path) if path.name == "__init__.py" else module_name(path)[:-1]
    base = package[: len(package) - node.level + 1]
    return ".".join([*base, *([node.module] if node.module else [])])


def _top_level(tree: ast.Module) -> Iterator[ast.stmt]:
    """Yield statements of a module, those inside top-level `if` and `try` included."""
    pending: list[ast.stmt] = list(tree.body)
    while pending:
        node = pending.pop(0)
        yield node
        if isinstance(node, ast.If | ast.Try):
            pending = [*node.body, *node.orelse, *pending]


def _names(path: Path, seen: frozenset[Path] = frozenset()) -> list[str]:
    """Return the public names of a module, those that it imports among them."""
    names: list[str] = []
    for node in _top_level(_tree(path)):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.append(node.name)
        elif isinstance(node, ast.ImportFrom) and node.names[0].name != "*":
            names.extend(alias.asname or alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and path not in seen:
            with suppress(UnknownTarget):
                names.extend(_names(_source(_imported_module(node, path), str(path)), seen | {path}))
    return [name for name in names if name[0] != "_"]


def lineage(
    node: ast.ClassDef, path: Path, target: str, seen: frozenset[tuple[Path, str]] = frozenset()
) -> Iterator[tuple[ast.ClassDef, Path]]:
    """Yield a class and its bases, depth first, each with the file where it stands."""
    yield node, path
    seen |= {(path, node.name)}
    for base in node.bases:
        found = parent_of(base, path, target)
        if found is not None and (found[1], found[0].name) not in seen:
            yield from lineage(*found, target, seen)


def parent_of(base: ast.expr, path: Path, target: str) -> tuple[ast.ClassDef, Path] | None:
    """Return the class that a base is, and its file; None for a builtin, or one that is made at run time."""
    try:
        parent, home = resolve_base(ast.unparse(base), path, target)
    except UnknownTarget:
        return None
    return (parent, home) if isinstance(parent, ast.ClassDef) else None


def resolve_base(name: str, path: Path, target: str) -> Home:
    """Resolve a base class as written: `Name`, or `package.module.Name` after an `import package`."""
    module, _, last = name.rpartition(".")
    return _resolve(_source(module, target), last, target) if module else _resolve(path, last, target)

"""Command-line overrides -> configs, the way Hydra composes them, with names checked first."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, cast

import hydra
from hydra import compose
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from parking_exp.config.grid import check_blocks, check_number, labels, points, seeds_of
from parking_exp.config.signatures import UnknownTarget, signature
from parking_exp.errors import ConfigError, ParkingError, suggestion

VERSION_BASE = "1.3"


@dataclass(frozen=True)
class Composed:
    """One run.

    Attributes:
        cell: its config as Hydra composed it, shared by all runs of the cell.
        seed: takes the place of the cell's; None: the cell's own.
        label: what sets its cell apart from the others, e.g. `her_final, n_sampled_goal=8`; empty for a single cell.
        rank: 0 for a cell's first seed, 1 for its second, ...
    """

    cell: DictConfig
    seed: int | None = None
    label: str = ""
    rank: int = 0

    @property
    def config(self) -> DictConfig:
        """The config of the run."""
        return self.cell if self.seed is None else cast(DictConfig, OmegaConf.merge(self.cell, {"seed": self.seed}))


def options_of(group: str) -> str:
    """List the options of a group, for `--help`: `${options:env}`."""
    return ", ".join(GlobalHydra.instance().config_loader().get_group_options(group))


OmegaConf.register_new_resolver("options", options_of, replace=True)


def config_dir() -> Path:
    """Return the directory of the Hydra tree: inside the package in a wheel, at the repository's top otherwise."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "conf"
    return inside if inside.is_dir() else package.parent / "conf"


def _show_launchers() -> None:
    """Let Hydra find our launchers in a checkout that is not installed: it looks into `hydra_plugins` alone."""
    plugins = str(Path(__file__).resolve().parents[1] / "plugins")
    if plugins not in sys.path and Path(plugins).is_dir():
        sys.path.append(plugins)


def quoted(argument: str) -> str:
    """Quote a path that Hydra's grammar can't read as it stands, e.g. `run=outputs/.../seed=0`."""
    key, equals, value = argument.partition("=")
    if not equals or "/" not in value or key.startswith("-"):
        return argument
    try:
        OverridesParser.create().parse_override(argument)
    except HydraException:
        return f"{key}={in_quotes(value)}"
    return argument


def in_quotes(value: str) -> str:
    """Write a string so that Hydra's grammar reads it as it is."""
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def composed(config_name: str, overrides: list[str], extra_config_dir: str | None = None) -> list[DictConfig]:
    """Compose the config of every run that a command line stands for; see `composed_runs`."""
    return [run.config for run in composed_runs(config_name, overrides, extra_config_dir)]


def composed_runs(config_name: str, overrides: list[str], extra_config_dir: str | None = None) -> list[Composed]:
    """Compose every run that a command line stands for (one, or each point of a sweep).

    `extra_config_dir` is Hydra's `--config-dir`: a directory of the user's own options. Overrides of Hydra itself are
    not the runs' (`hydra_overrides`).

    Raises:
        ConfigError: an override names no key or option, or the config does not compose.
    """
    with hydra_ready(extra_config_dir):
        parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
        parsed = parser.parse_overrides(overrides)
        _refuse_unknown_names(config_name, parsed)
        ours = [
            override
            for override in parsed
            if not override.key_or_group.startswith(("hydra/launcher", "hydra.launcher"))
        ]
        first = compose(config_name, _without_sweeps(ours), return_hydra_config=True)
        params = _container(first.hydra.sweeper.get("params")) or {}
        swept = parser.parse_overrides([f"{key}={value}" for key, value in params.items()])
        typed = _typed([override for override in [*swept, *parsed] if not _is_hydras(override.key_or_group)])
        if "seeds" not in first:
            return [Composed(compose(config_name, point)) for point in points([], typed, lambda key, point: True)]
        seeds, experiments = _typed_seeds(parsed), typed.pop("experiment", None)
        typed.pop("seeds", None)
        if experiments is None:
            return _runs(config_name, typed, seeds)
        return [run for name in experiments for run in _runs(config_name, {"experiment": [name], **typed}, seeds)]


def hydra_overrides(overrides: list[str]) -> list[str]:
    """Return the overrides that choose and set up the launcher."""
    parsed = OverridesParser.create().parse_overrides(overrides)
    others = ("hydra.sweeper", "hydra/sweeper", "hydra.mode", "hydra.run", "hydra.sweep", "hydra/help", "hydra.help")
    return [
        str(override.input_line)
        for override in parsed
        if _is_hydras(override.key_or_group) and not override.key_or_group.startswith(others)
    ]


def _is_hydras(key: str) -> bool:
    return key == "hydra" or key.startswith(("hydra.", "hydra/"))


def _runs(config_name: str, typed: dict[str, list[str]], seeds: list[int] | None) -> list[Composed]:
    """Compose every cell of an experiment once, and give it its seeds; all get their first before any its second."""
    base = compose(config_name, [f"{key}={typed[key][0]}" for key in ("experiment", "cells") if key in typed])
    blocks = check_blocks(_container(base.cells))
    in_blocks = {key for block in blocks for key in block}
    typed = {bare if (bare := key.lstrip("+")) in in_blocks else key: values for key, values in typed.items()}
    seeds = seeds or seeds_of(_container(base.seeds))
    if "seed" in typed or "seed" in in_blocks:
        seeds = None
    runs, cells = [], set()
    all_points = points(blocks, typed, lambda key, point: _has(config_name, key, point))
    check_number(len(all_points) * len(seeds or [None]), f"{len(all_points)} cells x {len(seeds or [None])} seeds")
    for point, label in zip(all_points, labels(all_points), strict=True):
        cell = compose(config_name, point)
        if (known := OmegaConf.to_yaml(cell)) in cells:  # blocks that differ may be the same once values are typed
            continue
        cells.add(known)
        runs += [Composed(cell, seed, label, rank) for rank, seed in enumerate(seeds or [None])]
    return sorted(runs, key=attrgetter("rank"))


def _has(config_name: str, key: str, point: list[str]) -> bool:
    """Whether the config of a point has a key, or its tree a group of that name."""
    if GlobalHydra.instance().config_loader().get_group_options(key):
        return True
    node: Any = compose(config_name, point)
    for part in key.split("."):
        if not isinstance(node, DictConfig) or part not in node:
            return False
        node = node[part]
    return True


def _typed_seeds(overrides: list[Override]) -> list[int] | None:
    """Read `seeds=5`, `seeds=[3,4]` or `seeds=3,4`, where it is typed."""
    for override in reversed(overrides):
        if override.key_or_group == "seeds":
            return seeds_of(list(override.sweep_iterator()) if override.is_sweep_override() else override.value())
    return None


def _typed(overrides: list[Override]) -> dict[str, list[str]]:
    """Return the values of each override, in Hydra's syntax; of a key that is named twice, the last.

    Raises:
        ConfigError: an axis without values, or both `seed` and `seeds`.
    """
    found = {}
    for override in overrides:
        if override.is_sweep_override() and not override.is_discrete_sweep():
            raise ConfigError(f"{override.input_line}: an axis needs values, not a range of them")
        values = override.sweep_string_iterator() if override.is_sweep_override() else None
        found[override.get_key_element()] = list(values or [override.get_value_element_as_str()])
    if {"seed", "seeds"} <= found.keys():
        raise ConfigError("seed and seeds are both given; seeds=[...] names several")
    return found


def _container(node: object) -> Any:
    return OmegaConf.to_container(node) if isinstance(node, DictConfig | ListConfig) else node


@contextmanager
def hydra_ready(extra_config_dir: str | None) -> Iterator[None]:
    """Make Hydra ready to compose from our tree and, with `--config-dir`, from one of the user's.

    Raises:
        ConfigError: what Hydra or OmegaConf complain about meanwhile, in their first sentence.
    """
    _show_launchers()
    search_path = create_config_search_path(str(config_dir()))
    if extra_config_dir:
        search_path.prepend("command-line", str(Path(extra_config_dir).absolute()), anchor="schema")
    instance = GlobalHydra.instance()
    outer = instance.hydra  # we may be called within a Hydra app, such as a benchmark or a user's own
    instance.clear()
    hydra.version.setbase(VERSION_BASE)
    Hydra.create_main_hydra2(task_name="parking_exp", config_search_path=search_path)
    try:
        with warnings.catch_warnings():
            # Our preset `ray` has the name of the launcher's own config, and may well be checked against it.
            warnings.filterwarnings("ignore", message=r"(?s).*validated against ConfigStore schema")
            yield
    except (HydraException, OmegaConfBaseException) as error:
        if isinstance(error.__cause__, ParkingError):  # of ours, and wrapped by Hydra
            raise error.__cause__ from error
        raise ConfigError(_first_sentence(error)) from error
    finally:
        instance.clear()
        instance.hydra = outer


def _without_sweeps(overrides: list[Override]) -> list[str]:
    """Overrides as typed, with the first value of each swept one."""
    lines = []
    for override in overrides:
        if override.is_sweep_override():
            lines.append(f"{override.get_key_element()}={next(iter(override.sweep_string_iterator()))}")
        else:
            lines.append(str(override.input_line))
    return lines


def _refuse_unknown_names(config_name: str, overrides: list[Override]) -> None:
    loader = GlobalHydra.instance().config_loader()
    ours = set(compose(config_name, return_hydra_config=True).hydra.runtime.choices)
    ours = {group for group in ours if not group.startswith("hydra")}
    groups, keys = [], []
    for override in overrides:
        name = override.key_or_group
        if not name:
            raise ConfigError(f"{override.input_line}: there is no key before the equals sign; write KEY=VALUE")
        if _is_hydras(name) and name != "hydra/launcher":
            continue
        options = loader.get_group_options(name)
        if not options:
            keys.append(override)
            continue
        if name not in ours and not _is_hydras(name):
            raise ConfigError(f"{name}: there is no such group here{suggestion(name, ours)}")
        if name in ours:
            groups.append(override)
        if override.type != OverrideType.DEL:
            _refuse_unknown_options(override, options)
    base = compose(config_name, _without_sweeps(groups))
    for override in keys:
        if override.type in {OverrideType.CHANGE, OverrideType.DEL}:
            _refuse_unknown_key(base, override, ours)


def _refuse_unknown_options(override: Override, options: list[str]) -> None:
    name, values = override.key_or_group, [override.value()]
    if override.package is not None:
        raise ConfigError(f"{override.input_line}: options have their place; write {name}=OPTION")
    if override.is_sweep_override():
        values = list(override.sweep_string_iterator())
    for value in values[0] if isinstance(values[0], list) else values:
        if value is None:
            raise ConfigError(f"{name}=null: leave it out, or choose from {', '.join(options)}")
        if str(value) not in options:
            raise ConfigError(f"{name}={value}: there is no such option{suggestion(str(value), options)}")


def _refuse_unknown_key(base: DictConfig, override: Override, groups: set[str]) -> None:
    node: object = base
    parts = override.key_or_group.split(".")
    for depth, part in enumerate(parts):
        known = [str(key) for key in node] if isinstance(node, DictConfig) else []
        if part not in known:
            parent = ".".join(parts[:depth])
            arguments = _arguments(node)
            if part in arguments:
                raise ConfigError(
                    f"{override.key_or_group}: an argument of {parent}._target_ that its YAML does not list; "
                    f"write +{override.input_line}"
                )
            if parent and isinstance(node, DictConfig) and not known:
                raise ConfigError(f"{override.key_or_group}: {parent} is empty so far; write +{override.input_line}")
            if not parent and part in groups:
                raise ConfigError(f"{part}: no option is chosen; write {part}=OPTION {override.input_line}")
            choices = {*known, *arguments, *([] if parent else groups)}
            raise ConfigError(f"{override.key_or_group}: there is no such key{suggestion(part, choices)}")
        assert isinstance(node, DictConfig)
        node = node._get_node(part) if node._is_none() else node[part]


def _arguments(node: object) -> set[str]:
    """Constructor arguments of a `_target_` node."""
    if not isinstance(node, DictConfig) or "_target_" not in node:
        return set()
    try:
        return set(signature(node["_target_"]).parameters)
    except UnknownTarget:
        return set()


def _first_sentence(error: Exception) -> str:
    if isinstance(error, OverrideParseException):
        quoting = """a list is [1,2], and text with spaces, quotes or brackets stands in quotes: "KEY='a (b)'\""""
        return f"{error.override}: can't be read; write KEY=VALUE, where {quoting}"
    merging = "Error merging override "
    if str(error).startswith(merging):
        override = str(error).splitlines()[0].removeprefix(merging)
        return f"{override}: a value of another kind stands there; see it with --cfg job"
    lines = [line.strip().rstrip(".") for line in str(error).splitlines() if line.strip()]
    hint = [line for line in lines[1:2] if line.startswith("To append")]
    return "; ".join([*lines[:1], *hint]) or type(error).__name__

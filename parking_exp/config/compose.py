"""Compose configs from `conf/` and command-line overrides with Hydra."""

import copy
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache, lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar, cast

import hydra
import yaml
from hydra import initialize_config_dir
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import OverrideType
from hydra.core.plugins import Plugins
from hydra.errors import HydraException, OverrideParseException
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig, ListConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from parking_exp.config.experiment_files import experiment_files
from parking_exp.config.grid import check_blocks, check_number, points, seeds_of
from parking_exp.config.overrides import (
    OptionsOf,
    check_groups,
    check_keys,
    expand_groups,
    first_values,
    is_group,
    is_hydras,
    is_launchers,
    typed_seeds,
    typed_values,
)
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate
from parking_exp.errors import ConfigError, ParkingError

VERSION_BASE = "1.3"
MOST_CACHED = 100  # compositions, of some 100 KB each


@dataclass(frozen=True)
class Composed:
    """One run.

    Attributes:
        cell: its config as Hydra composed it, shared by all runs of the cell.
        seed: takes the place of the cell's; None: the cell's own.
        label: of its cell; empty: what sets its config apart from those of the other cells.
        rank: 0 for a cell's first seed, 1 for its second, ...
        options: group -> chosen option.
    """

    cell: DictConfig
    seed: int | None = None
    label: str = ""
    rank: int = 0
    options: Mapping[str, str] = field(default_factory=dict)

    @property
    def config(self) -> DictConfig:
        """The config of the run."""
        return self.cell if self.seed is None else cast(DictConfig, OmegaConf.merge(self.cell, {"seed": self.seed}))


@dataclass(frozen=True)
class Composition:
    """One config as Hydra composed it, apart from Hydra's own node.

    Attributes:
        config: without the node `hydra`.
        options: the groups that its defaults lists choose from, and what is chosen.
        sweep: `hydra.sweeper.params`.
    """

    config: DictConfig
    options: dict[str, str]
    sweep: Mapping[str, object]


Compose = Callable[..., Composition]  # of overrides, in Hydra's syntax


def compose(*overrides: str) -> RunConfig:
    """Return the checked config of one run: `compose("experiment=smoke", "seed=1")`, for `train`.

    Raises:
        ConfigError: an override is wrong, or they stand for several runs.
    """
    runs = composed("config", list(overrides))
    if len(runs) > 1:
        raise ConfigError(f"these overrides stand for {len(runs)} runs, and compose() returns one; give one value each")
    return validate(runs[0])


def composed(config_name: str, overrides: list[str], extra_config_dir: str | None = None) -> list[DictConfig]:
    """Compose the config of every run that a command line stands for; see `composed_runs`."""
    return [run.config for run in composed_runs(config_name, overrides, extra_config_dir)]


def composed_runs(config_name: str, overrides: list[str], extra_config_dir: str | None = None) -> list[Composed]:
    """Compose every run that a command line stands for: one, or each point of a sweep.

    Names are checked against the config of the chosen options; then each cell is composed once.

    Args:
        config_name: file in `conf/`.
        overrides: as they are typed; those of Hydra itself are not the runs' (`hydra_overrides`).
        extra_config_dir: Hydra's `--config-dir`, a directory of the user's own options.

    Raises:
        ConfigError: an override names no key or option, or the config does not compose.
    """
    overrides, folders = experiment_files(overrides)
    with hydra_ready(extra_config_dir, *folders):
        loader = GlobalHydra.instance().config_loader()
        parser = OverridesParser.create(config_loader=loader)
        options_of = cache(loader.get_group_options)
        compose_lines = _compose_with(config_name, options_of)
        parsed = expand_groups(overrides, parser, options_of)
        groups = compose_lines().options.keys()
        check_groups(parsed, groups, options_of)
        ours = [one for one in parsed if not is_launchers(one.key_or_group)]
        chosen = first_values(one for one in ours if is_group(one, options_of) or is_hydras(one.key_or_group))
        base = compose_lines(*chosen)
        check_keys(base.config, parsed, groups, options_of)
        swept = parser.parse_overrides([f"{key}={value}" for key, value in base.sweep.items()])
        typed = typed_values([one for one in [*swept, *parsed] if not is_hydras(one.key_or_group)])
        if "seeds" not in base.config:
            return [Composed(compose_lines(*point).config) for point in points([], typed, lambda key, point: True)]
        seeds, experiments = typed_seeds(parsed), typed.pop("experiment", None)
        typed.pop("seeds", None)
        named = [{"experiment": [name], **typed} for name in experiments] if experiments else [typed]
        return [run for one in named for run in _runs(compose_lines, options_of, one, seeds)]


def _compose_with(config_name: str, options_of: OptionsOf) -> Compose:
    """Return a function that composes a config with some overrides.

    Hydra takes more than a tenth of a second for that. So it composes each choice of options once, and values of keys
    are set in a copy.
    """
    parser = OverridesParser.create()
    # The user's own directories may be large, and are read anew in each call.
    state: object = object() if UserDirectories.paths else _state_of_tree()

    def compose_lines(*lines: str) -> Composition:
        overrides = parser.parse_overrides(list(lines))
        values = [one for one in overrides if not is_group(one, options_of)]
        if all(one.type is OverrideType.CHANGE and not is_hydras(one.key_or_group) for one in values):
            options = tuple(str(one.input_line) for one in overrides if one not in values)
            composition = copy.deepcopy(_compose_once(config_name, options, state))
            with suppress(OmegaConfBaseException):  # composed below, where Hydra says which override is wrong
                for one in values:
                    OmegaConf.update(composition.config, one.key_or_group, one.value(), merge=True)
                return composition
        return _compose(config_name, lines)

    return compose_lines


def _compose(config_name: str, lines: Sequence[str]) -> Composition:
    config = hydra.compose(config_name, list(lines), return_hydra_config=True)
    options = {str(k): v for k, v in config.hydra.runtime.choices.items() if not str(k).startswith("hydra")}
    sweep = _container(config.hydra.sweeper.get("params")) or {}
    with open_dict(config):
        del config["hydra"]
    return Composition(config, options, sweep)


@lru_cache(maxsize=MOST_CACHED)
def _compose_once(config_name: str, lines: Sequence[str], state: object) -> Composition:
    """Compose, once for each state of the tree's files in a process."""
    return _compose(config_name, lines)


def _runs(
    compose_lines: Compose, options_of: OptionsOf, typed: dict[str, list[str]], seeds: list[int] | None
) -> list[Composed]:
    """Compose every cell of an experiment, and give it its seeds; all get their first before any its second."""
    base = compose_lines(*(f"{key}={typed[key][0]}" for key in ("experiment", "cells") if key in typed)).config
    blocks = check_blocks(_container(base.cells))
    experiment = typed.get("experiment", [""])[0]
    in_blocks = {key for block in blocks for key in block}
    typed = {bare if (bare := key.lstrip("+")) in in_blocks else key: values for key, values in typed.items()}
    if seeds is None:
        seeds = seeds_of(_container(base.seeds))
    if "seed" in typed or "seed" in in_blocks:
        seeds = None
    runs, cells = [], set()

    def has(key: str, point: list[str]) -> bool:
        return bool(options_of(key)) or _has(compose_lines, key, point)

    all_points = points(blocks, typed, has, experiment)
    check_number(len(all_points) * len(seeds or [None]), f"{len(all_points)} cells x {len(seeds or [None])} seeds")
    for point in all_points:
        composition = _cell(compose_lines, has, point)
        cell = composition.config
        if (known := OmegaConf.to_yaml(cell)) in cells:  # blocks that differ may be the same once values are typed
            continue
        cells.add(known)
        runs += [Composed(cell, seed, "", rank, composition.options) for rank, seed in enumerate(seeds or [None])]
    return sorted(runs, key=attrgetter("rank"))


def _cell(compose_lines: Compose, has: Callable[[str, list[str]], bool], point: list[str]) -> Composition:
    """Compose a cell.

    Raises:
        ConfigError: one of its options lacks one of its keys.
    """
    try:
        return compose_lines(*point)
    except HydraException as error:
        for key in (line.partition("=")[0] for line in point):
            option = next((line for line in point if line.startswith(f"{key.partition('.')[0]}=")), None)
            if option and not has(key, [option]):
                raise ConfigError(f"{key}: {option} has no such key; leave out the option or the key") from error
        raise


def _has(compose_lines: Compose, key: str, point: list[str]) -> bool:
    """Whether the config of a point has a key."""
    node: Any = compose_lines(*point).config
    for part in key.split("."):
        if not isinstance(node, DictConfig) or part not in node:
            return False
        node = node[part]
    return True


def _container(node: object) -> Any:
    return OmegaConf.to_container(node) if isinstance(node, DictConfig | ListConfig) else node


def options_of(group: str) -> str:
    """List the options of a group, for `--help`: `${options:env}`."""
    return ", ".join(GlobalHydra.instance().config_loader().get_group_options(group))


OmegaConf.register_new_resolver("options", options_of, replace=True)


def config_dir() -> Path:
    """Return the directory of the Hydra tree: inside the package in a wheel, at the repository's top otherwise."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "conf"
    return inside if inside.is_dir() else package.parent / "conf"


class UserDirectories(SearchPathPlugin):
    """Adds directories of the user's own options to Hydra's search path, behind ours."""

    paths: ClassVar[Sequence[str]] = ()

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append the directories."""
        for number, path in enumerate(self.paths):
            search_path.append(f"command-line {number}", path)


@cache
def _register_plugins() -> None:
    # Hydra looks for launchers in `hydra_plugins` alone, and a checkout need not be installed.
    plugins = str(Path(__file__).resolve().parents[1] / "plugins")
    if plugins not in sys.path and Path(plugins).is_dir():
        sys.path.append(plugins)
    Plugins.instance().register(UserDirectories)


@contextmanager
def hydra_ready(extra_config_dir: str | None, *more: str) -> Iterator[None]:
    """Make Hydra ready to compose from our tree and, with `--config-dir` and experiment files, from the user's.

    Raises:
        ConfigError: what Hydra or OmegaConf complain about meanwhile, in their first sentence.
    """
    _register_plugins()
    outer = GlobalHydra.instance().hydra  # we may be called within a Hydra app, such as a benchmark or a user's own
    GlobalHydra.instance().clear()
    UserDirectories.paths = [str(Path(one).absolute()) for one in (extra_config_dir, *more) if one]
    try:
        with (
            initialize_config_dir(str(config_dir()), "parking_exp", VERSION_BASE),
            warnings.catch_warnings(),
        ):
            # Our preset `ray` has the name of the launcher's own config, and may well be checked against it.
            warnings.filterwarnings("ignore", message=r"(?s).*validated against ConfigStore schema")
            yield
    except yaml.YAMLError as error:
        raise ConfigError(f"a YAML file can't be read: {' '.join(str(error).split())}") from error
    except (HydraException, OmegaConfBaseException) as error:
        if isinstance(error.__cause__, ParkingError):  # of ours, and wrapped by Hydra
            raise error.__cause__ from error
        raise ConfigError(_first_sentence(error)) from error
    finally:
        UserDirectories.paths = ()
        GlobalHydra.instance().hydra = outer


def _state_of_tree() -> frozenset[tuple[Path, int]]:
    """Return the files of our tree and when each was changed."""
    return frozenset((path, path.stat().st_mtime_ns) for path in config_dir().rglob("*.yaml"))


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

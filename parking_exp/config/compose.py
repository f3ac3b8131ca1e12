"""Compose configs from `conf/` and command-line overrides with Hydra."""

import copy
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, cast

import hydra
import yaml
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import CachingConfigRepository, IConfigRepository
from hydra._internal.hydra import Hydra
from hydra._internal.utils import create_config_search_path
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, OverrideParseException
from hydra.plugins.config_source import ConfigResult
from omegaconf import DictConfig, ListConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from parking_exp.config.experiment_files import experiment_files
from parking_exp.config.grid import check_blocks, check_number, points, seeds_of
from parking_exp.config.overrides import (
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
MOST_KEPT = 100  # compositions, of some 100 KB each


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
        compose_lines = _compose_with(config_name)
        parsed = expand_groups(overrides, parser, loader)
        groups = compose_lines().options.keys()
        check_groups(parsed, groups, loader)
        ours = [one for one in parsed if not is_launchers(one.key_or_group)]
        chosen = first_values(one for one in ours if is_group(one, loader) or is_hydras(one.key_or_group))
        base = compose_lines(*chosen)
        _repository().keep(config_name, {(): compose_lines(), tuple(chosen): base})
        check_keys(base.config, parsed, groups, loader)
        swept = parser.parse_overrides([f"{key}={value}" for key, value in base.sweep.items()])
        typed = typed_values([one for one in [*swept, *parsed] if not is_hydras(one.key_or_group)])
        if "seeds" not in base.config:
            return [Composed(compose_lines(*point).config) for point in points([], typed, lambda key, point: True)]
        seeds, experiments = typed_seeds(parsed), typed.pop("experiment", None)
        typed.pop("seeds", None)
        named = [{"experiment": [name], **typed} for name in experiments] if experiments else [typed]
        return [run for one in named for run in _runs(compose_lines, one, seeds)]


def _compose_with(config_name: str) -> Compose:
    """Return a function that composes a config with some overrides; what it has composed before, it returns again."""
    repository = _repository()
    parser = OverridesParser.create()

    @cache
    def compose_lines(*lines: str) -> Composition:
        if (kept := repository.compositions.get((config_name, lines))) is not None:
            return copy.deepcopy(kept)
        values = [one for one in parser.parse_overrides(list(lines)) if _is_value(one, repository)]
        if values:  # Hydra, too, applies them at its end; what comes before takes some ten times as long
            typed = {one.input_line for one in values}
            plain = compose_lines(*(line for line in lines if line not in typed))
            changed = copy.deepcopy(plain.config)
            ConfigLoaderImpl._apply_overrides_to_config(values, changed)
            return replace(plain, config=changed)
        config = hydra.compose(config_name, list(lines), return_hydra_config=True)
        options = {str(k): v for k, v in config.hydra.runtime.choices.items() if not str(k).startswith("hydra")}
        sweep = _container(config.hydra.sweeper.get("params")) or {}
        with open_dict(config):
            del config["hydra"]
        return Composition(config, options, sweep)

    return compose_lines


def _is_value(override: Override, repository: IConfigRepository) -> bool:
    """Whether an override sets a key, and neither chooses an option nor is Hydra's."""
    is_choice = repository.group_exists(override.key_or_group) and not isinstance(override.value(), dict)
    return not (is_choice or override.is_sweep_override() or is_hydras(override.key_or_group))


def _runs(compose_lines: Compose, typed: dict[str, list[str]], seeds: list[int] | None) -> list[Composed]:
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
    all_points = points(blocks, typed, lambda key, point: _has(compose_lines, key, point), experiment)
    check_number(len(all_points) * len(seeds or [None]), f"{len(all_points)} cells x {len(seeds or [None])} seeds")
    for point in all_points:
        composition = _cell(compose_lines, point)
        cell = composition.config
        if (known := OmegaConf.to_yaml(cell)) in cells:  # blocks that differ may be the same once values are typed
            continue
        cells.add(known)
        runs += [Composed(cell, seed, "", rank, composition.options) for rank, seed in enumerate(seeds or [None])]
    return sorted(runs, key=attrgetter("rank"))


def _cell(compose_lines: Compose, point: list[str]) -> Composition:
    """Compose a cell.

    Raises:
        ConfigError: one of its options lacks one of its keys.
    """
    try:
        return compose_lines(*point)
    except HydraException as error:
        for key in (line.partition("=")[0] for line in point):
            option = next((line for line in point if line.startswith(f"{key.partition('.')[0]}=")), None)
            if option and not _has(compose_lines, key, [option]):
                raise ConfigError(f"{key}: {option} has no such key; leave out the option or the key") from error
        raise


def _has(compose_lines: Compose, key: str, point: list[str]) -> bool:
    """Whether the config of a point has a key, or its tree a group of that name."""
    if GlobalHydra.instance().config_loader().get_group_options(key):
        return True
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


class KeptFiles(CachingConfigRepository):
    """The YAML files of the tree, each read once, and what options alone compose to.

    Hydra reads them anew for each config that it composes, which is most of the time that this takes.
    """

    def __init__(self, delegate: IConfigRepository) -> None:
        """Wrap Hydra's own repository."""
        super().__init__(delegate)
        self.compositions: dict[tuple[str, tuple[str, ...]], Composition] = {}

    def keep(self, config_name: str, compositions: Mapping[tuple[str, ...], Composition]) -> None:
        """Keep what lines compose to, for the next call in this process."""
        for lines, composition in compositions.items():
            is_hydras = any(line.lstrip("+~").startswith("hydra") for line in lines)
            if (config_name, lines) not in self.compositions and len(self.compositions) < MOST_KEPT and not is_hydras:
                self.compositions[config_name, lines] = copy.deepcopy(composition)

    def load_config(self, config_path: str) -> ConfigResult | None:
        """Return a copy of a file's content: what Hydra merges into it must not stay."""
        return copy.deepcopy(super().load_config(config_path))

    def initialize_sources(self, config_search_path: ConfigSearchPath) -> None:
        """Look elsewhere from now on (`hydra.searchpath`), which the next call must not do."""
        _kept_files.cache_clear()
        super().initialize_sources(config_search_path)

    def __deepcopy__(self, memo: object) -> "KeptFiles":
        """Return itself: Hydra takes a copy for each config, and would lose what that one has read."""
        return self


@contextmanager
def hydra_ready(extra_config_dir: str | None, *more: str) -> Iterator[None]:
    """Make Hydra ready to compose from our tree and, with `--config-dir` and experiment files, from the user's.

    Raises:
        ConfigError: what Hydra or OmegaConf complain about meanwhile, in their first sentence.
    """
    hydra.version.setbase(VERSION_BASE)
    instance = GlobalHydra.instance()
    outer = instance.hydra  # we may be called within a Hydra app, such as a benchmark or a user's own
    extra = [str(Path(one).absolute()) for one in (extra_config_dir, *more) if one]
    ours = _set_up(*extra)
    plain = ours.config_loader.repository
    # The user's own directories may be large, and are read anew in each call.
    ours.config_loader.repository = KeptFiles(plain) if extra else _kept_files(plain, _state_of_tree())
    instance.hydra = ours
    try:
        with warnings.catch_warnings():
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
        ours.config_loader.repository = plain
        instance.hydra = outer


def _repository() -> KeptFiles:
    return cast(KeptFiles, cast(ConfigLoaderImpl, GlobalHydra.instance().config_loader()).repository)


@lru_cache(maxsize=1)
def _kept_files(plain: IConfigRepository, state: frozenset[tuple[Path, int]]) -> KeptFiles:
    """Return our tree's files as they are in this state: several calls in one process read and compose them once."""
    return KeptFiles(plain)


def _state_of_tree() -> frozenset[tuple[Path, int]]:
    """Return the files of our tree and when each was changed."""
    return frozenset((path, path.stat().st_mtime_ns) for path in config_dir().rglob("*.yaml"))


@cache
def _set_up(*extra_config_dirs: str) -> Any:
    """Set Hydra up, once in a process for the same directories of the user's."""
    # Hydra looks for launchers in `hydra_plugins` alone, and a checkout need not be installed.
    plugins = str(Path(__file__).resolve().parents[1] / "plugins")
    if plugins not in sys.path and Path(plugins).is_dir():
        sys.path.append(plugins)
    search_path = create_config_search_path(str(config_dir()))
    for number, folder in enumerate(extra_config_dirs):
        search_path.prepend(f"command-line {number}", folder, anchor="schema")
    return Hydra(task_name="parking_exp", config_loader=ConfigLoaderImpl(config_search_path=search_path))


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

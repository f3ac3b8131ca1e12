"""Compose configs from `conf/` and command-line overrides with Hydra."""

import copy
import textwrap
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import hydra
import yaml
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import OverrideType
from hydra.errors import HydraException
from omegaconf import DictConfig, ListConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from parking_exp.config.grid import MAX_RUNS, Block, Point, expand_points, read_blocks, seeds_of
from parking_exp.config.hydra_errors import explain
from parking_exp.config.hydra_settings import check_hydra_settings
from parking_exp.config.overrides import (
    axes_of,
    conf_dir,
    in_quotes,
    is_hydra_override,
    parse_overrides,
    to_hydra_syntax,
)
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate
from parking_exp.errors import ConfigError, ParkingError

VERSION_BASE = "1.3"
LAUNCHING = ("config", "tune")  # roots of the commands that launch runs


@dataclass(frozen=True, eq=False)
class ComposedCell:
    """A cell as Hydra composed it. All its runs share this object; cells are compared by identity.

    Attributes:
        config: its config; a run with a seed replaces the config's seed.
        options: the option of each group.
        launcher: the name of its launcher.
        launcher_settings: the launcher's class and arguments.
    """

    config: DictConfig
    options: Mapping[str, str]
    launcher: str
    launcher_settings: Mapping[str, Any]

    def with_values(self, values: Mapping[str, Any]) -> "ComposedCell":
        """Return a copy with other values of keys; `+KEY` adds a key.

        This takes 3 ms, where Hydra takes 0.1 to 0.3 s.
        """
        config = copy.deepcopy(self.config)
        for key, value in values.items():
            OmegaConf.update(
                config, key.lstrip("+"), value, merge=True, force_add=key.startswith("+")
            )
        return replace(self, config=config)


class ComposedRun(NamedTuple):
    """A run of a cell; without a seed, it has the seed of the cell's config."""

    cell: ComposedCell
    seed: int | None

    @property
    def config(self) -> DictConfig:
        """The config of the run."""
        if self.seed is None:
            return self.cell.config
        return cast(DictConfig, OmegaConf.merge(self.cell.config, {"seed": self.seed}))


def compose(*overrides: str, config_dir: str | Path | None = None) -> RunConfig:
    """Return the checked config of one run: `compose("experiment=smoke", "seed=1")`, for `train`.

    Args:
        overrides: the words of a command line.
        config_dir: a directory of your own options, as `--config-dir`.

    Raises:
        ConfigError: an override is wrong, the overrides define several runs, or there is no such
            directory.
    """
    runs = compose_configs("config", list(overrides), config_dir)
    if len(runs) > 1:
        raise ConfigError(
            f"these overrides define {len(runs)} runs, but compose() returns one; give one value "
            "each"
        )
    return validate(runs[0])


def compose_configs(
    config_name: str, overrides: list[str], extra_config_dir: str | Path | None = None
) -> list[DictConfig]:
    """Compose the config of every run of a command line; see `compose_runs`."""
    return [run.config for run in compose_runs(config_name, overrides, extra_config_dir)]


def compose_runs(
    config_name: str, overrides: list[str], extra_config_dir: str | Path | None = None
) -> list[ComposedRun]:
    """Compose every run of a command line: one, or each point of a sweep.

    Args:
        config_name: file in `conf/`.
        overrides: words in Hydra's syntax, and `experiment=PATH.yaml`.
        extra_config_dir: Hydra's `--config-dir`, a directory of the user's own options.

    Raises:
        ConfigError: an override names no key or option, the config does not compose, or there is no
            such directory.
    """
    words = [to_hydra_syntax(word) for word in overrides]
    hydra_overrides = [*user_options(extra_config_dir), *filter(is_hydra_override, words)]
    with hydra_ready():
        composer = _Composer(config_name, hydra_overrides)
        axes = axes_of(word for word in words if not is_hydra_override(word))
        experiments = axes.pop("experiment", None)
        if experiments is None:
            return _expand_runs(composer, axes)
        runs = []
        for name in experiments:
            runs += _expand_runs(composer, {"experiment": [name], **axes})
        return runs


class _Composer:
    """Composes the cells of a command line; Hydra composes each choice of options once."""

    def __init__(self, config_name: str, hydra_overrides: list[str]) -> None:
        self._config_name = config_name
        self._hydra_overrides = hydra_overrides
        self._groups = GlobalHydra.instance().config_loader().list_groups("")
        self._composed: dict[Point, ComposedCell] = {}

    def compose(self, overrides: Point) -> ComposedCell:
        """Compose a cell, and check its level."""
        cell = self._merge(overrides)
        if any(override.lstrip("+").startswith("env.level=") for override in overrides):
            _check_level(cell.config.env)
        return cell

    def _merge(self, overrides: Point) -> ComposedCell:
        """Compose a cell: its options by Hydra, and the other changes on top of them."""
        options = [override for override in overrides if self._is_option(override)]
        values = {}
        for change in parse_overrides(item for item in overrides if item not in options):
            if change.type is not OverrideType.CHANGE or change.package is not None:
                return self._compose_by_hydra(overrides).with_values({})
            values[change.key_or_group] = change.value()
        return self._compose_by_hydra(tuple(options)).with_values(values)

    def _is_option(self, override: str) -> bool:
        """Return whether an override chooses an option of a group."""
        return override.partition("=")[0] in self._groups and "={" not in override

    def _compose_by_hydra(self, overrides: Point) -> ComposedCell:
        """Compose overrides by Hydra; cached, since it takes 0.1 to 0.3 s."""
        if overrides not in self._composed:
            self._composed[overrides] = self._call_hydra([*self._hydra_overrides, *overrides])
        return self._composed[overrides]

    def _call_hydra(self, overrides: list[str]) -> ComposedCell:
        """Compose overrides by Hydra, and separate Hydra's own settings."""
        try:
            config = hydra.compose(self._config_name, overrides, return_hydra_config=True)
        except ValueError as error:  # a group is set to a number or to null
            raise ConfigError(f"{' '.join(overrides)}: {error}") from error
        # Our own files set no key that is refused: only a user's file or override can.
        if self._hydra_overrides or any("/" in override for override in overrides):
            plain = hydra.compose(self._config_name, return_hydra_config=True)
            launches_runs = self._config_name in LAUNCHING
            check_hydra_settings(config.hydra, plain.hydra, launches_runs=launches_runs)
        choices = {str(group): option for group, option in config.hydra.runtime.choices.items()}
        options = {
            group: option for group, option in choices.items() if not group.startswith("hydra")
        }
        launcher = choices["hydra/launcher"]
        settings = cast(dict[str, Any], OmegaConf.to_container(config.hydra.launcher, resolve=True))
        with open_dict(config):
            del config["hydra"]
        return ComposedCell(config, options, launcher, settings)


def _expand_runs(composer: _Composer, axes: dict[str, list[str]]) -> list[ComposedRun]:
    """Compose every cell of an experiment with its first seed, then with its second, and so on."""
    experiment = [f"{key}={axes[key][0]}" for key in ("experiment", "cells") if key in axes]
    base = composer.compose(tuple(experiment)).config
    if "seeds" in axes and "seeds" not in base:
        raise ConfigError("seeds: this command has no such key; leave it out")
    blocks: list[Block] = []
    if "seeds" in base:  # a report's cells are labels
        blocks = read_blocks(_container(base.cells))

    seeds = _pop_seeds(axes, blocks, _container(base.get("seeds")))

    def has(key: str, point: Point) -> bool:
        section, _, name = key.rpartition(".")
        node = OmegaConf.select(composer.compose(point).config, section) if section else base
        return isinstance(node, DictConfig) and name in node

    all_seeds: list[int] | list[None] = seeds or [None]
    all_points = expand_points(blocks, axes, has, axes.get("experiment", [""])[0])
    if len(all_points) * len(all_seeds) > MAX_RUNS:
        raise ConfigError(
            f"{len(all_points)} cells x {len(all_seeds)} seeds: a sweep has at most {MAX_RUNS} runs"
        )
    cells: dict[str, ComposedCell] = {}
    for point in all_points:
        cell = composer.compose(point)
        # Blocks may overlap. `str` tells all configs apart, and is 40 times faster than `to_yaml`.
        cells[str(cell.config)] = cell

    runs = []
    for seed in all_seeds:
        runs += [ComposedRun(cell, seed) for cell in cells.values()]
    return runs


def _pop_seeds(axes: dict[str, list[str]], blocks: list[Block], default: Any) -> list[int] | None:
    """Remove the seeds that all cells share from the axes, and return them, or else the default.

    None: each cell has the seed of its own config.
    """
    values = [yaml.safe_load(value) for value in axes.pop("seeds", [])] or [default]
    seeds = seeds_of(values[0] if len(values) == 1 else values)
    given = axes.get("seed", [])
    is_swept = any("seed" in block for block in blocks)
    if len(given) > 1 and not is_swept and all(map(str.isdecimal, given)):
        # A cell is composed once for all its seeds.
        return seeds_of([int(seed) for seed in axes.pop("seed")])
    if given or is_swept:
        return None
    return seeds


def _container(node: object) -> Any:
    return OmegaConf.to_container(node) if isinstance(node, DictConfig | ListConfig) else node


def options_of(group: str) -> str:
    """List the options of a group, for `--help`: `${options:env}`."""
    options = GlobalHydra.instance().config_loader().get_group_options(group)
    return textwrap.fill(", ".join(options), 100, subsequent_indent=" " * (len(group) + 2))


def value_of_level(key: str, _root_: DictConfig) -> Any:
    """Return a value of the chosen level of an env: `${level:slot_length_m}`.

    Raises:
        ConfigError: there is no such level.
    """
    levels = _root_.env.levels
    level = _root_.env.level
    if level not in levels:
        raise ConfigError(f"env.level={level}: choose from {', '.join(levels)}")
    return levels[level][key]


def _check_level(env: DictConfig) -> None:
    """Refuse a level that no key of an env depends on; a stored env has no levels."""
    if env.level and "levels" in env and "${level:" not in OmegaConf.to_yaml(env):
        raise ConfigError(
            f"env.level={env.level} has no effect: no key of env={env.name} depends on the level"
        )


OmegaConf.register_new_resolver("options", options_of, replace=True)
OmegaConf.register_new_resolver("level", value_of_level, replace=True)


def user_options(extra_config_dir: str | Path | None) -> list[str]:
    """Return the override that adds a user's folder of options to the search path, after ours.

    Raises:
        ConfigError: there is no such folder.
    """
    if extra_config_dir is None:
        return []
    path = Path(extra_config_dir)
    if not path.is_dir():
        raise ConfigError(f"--config-dir={path} (in Python config_dir) is not a directory")
    return [f"hydra.searchpath=[{in_quotes(str(path.absolute()))}]"]


@contextmanager
def hydra_ready() -> Iterator[None]:
    """Initialize Hydra with our configs; turn errors of Hydra and OmegaConf into ConfigError."""
    # We may be called within a Hydra app, such as a benchmark or a user's own.
    outer = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with (
            initialize_config_dir(str(conf_dir()), "parking_exp", VERSION_BASE),
            warnings.catch_warnings(),
        ):
            # Our preset `ray` has the name of the plugin's own config; validating it against that
            # is harmless.
            warnings.filterwarnings("ignore", message=r"(?s).*validated against ConfigStore schema")
            yield
    except (HydraException, OmegaConfBaseException, yaml.YAMLError) as error:
        if isinstance(error.__cause__, ParkingError):  # ours, wrapped by Hydra
            raise error.__cause__ from error
        raise ConfigError(explain(error)) from error
    finally:
        GlobalHydra.instance().hydra = outer

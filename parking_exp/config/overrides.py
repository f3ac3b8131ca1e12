"""Command-line overrides in Hydra's grammar: quoting, parsing, the values of each key."""

import os
import re
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException

from parking_exp.config.grid import MOST_CELLS
from parking_exp.errors import ConfigError


def in_quotes(value: str) -> str:
    """Quote a string for Hydra's grammar."""
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"


def quoted(argument: str) -> str:
    """Quote a path that Hydra's grammar can't parse unquoted, e.g. `run=outputs/.../seed=0`."""
    key, equals, value = argument.partition("=")
    if not equals or "/" not in value or key.startswith("-"):
        return argument
    try:
        OverridesParser.create().parse_override(argument)
    except HydraException:
        return f"{key}={in_quotes(value)}"
    return argument


def is_hydras(override: str) -> bool:
    """Return whether an override changes Hydra's own config, e.g. its launcher."""
    return re.match(r"[+~]*hydra\b", override) is not None


def hydra_overrides(overrides: Iterable[str]) -> list[str]:
    """Return the overrides that choose and set up the launcher."""
    others = re.compile(r"[+~]*hydra[./](sweeper|mode|run|sweep|help)\b")
    return [override for override in overrides if is_hydras(override) and not others.match(override)]


def parse(overrides: Iterable[str]) -> list[Override]:
    """Parse overrides, within `hydra_ready`."""
    parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
    parsed: list[Override] = []
    for override in overrides:
        try:
            parsed += parser.parse_overrides([override])
        except ValueError as error:  # int() of a long text
            raise ConfigError(f"{override.partition('=')[0]}: a number has too many digits") from error
        if not parsed[-1].key_or_group:
            raise ConfigError(f"{override}: there is no key before the equals sign; write KEY=VALUE")
    return parsed


def axes_of(overrides: Iterable[str]) -> dict[str, list[str]]:
    """Return the values of each key, in Hydra's syntax; of a key that is overridden twice, the last."""
    axes = {}
    for override in parse(overrides):
        values = [] if override.is_sweep_override() else [override.get_value_element_as_str()]
        if override.is_discrete_sweep():
            values = list(islice(override.sweep_string_iterator(), MOST_CELLS + 1))
        if not values:
            raise ConfigError(f"{override.input_line}: there are no values to sweep over")
        if len(values) > MOST_CELLS:
            raise ConfigError(f"{override.input_line}: a sweep has at most {MOST_CELLS} cells")
        axes[override.get_key_element()] = values
    if "seed" in axes and axes.get("seeds", ["null"]) != ["null"]:
        raise ConfigError("seed and seeds are both given; seeds=[...] names several")
    return axes


def experiment_option(override: str, config_dir: Path) -> str:
    """Replace `experiment=PATH.yaml` by an option of Hydra's: a path relative to the config group."""
    if (path := _experiment_path(override)) is None:
        return override
    if not path.is_file():
        raise ConfigError(f"experiment={path}: there is no such file")
    return f"experiment={in_quotes(os.path.relpath(path.resolve().with_suffix(''), config_dir / 'experiment'))}"


def with_absolute_path(override: str) -> str:
    """Return an override, with the path of an experiment file made absolute."""
    path = _experiment_path(override)
    return override if path is None else f"experiment={in_quotes(str(path.absolute()))}"


def _experiment_path(override: str) -> Path | None:
    """Return the path of an experiment file in an override; None where it has none."""
    key, _, value = override.partition("=")
    if value[:1] in {"'", '"'}:
        value = re.sub(r"\\(.)", r"\1", value[1:-1])  # undo `in_quotes`
    path = Path(value).expanduser()
    return path if key == "experiment" and path.suffix == ".yaml" else None

"""Command-line overrides in Hydra's grammar: quoting, parsing, the values of each key."""

import os
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException

from parking_exp.errors import ConfigError


def config_dir() -> Path:
    """Return the directory of the Hydra tree: inside the package in a wheel, at the repository's top otherwise."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "conf"
    return inside if inside.is_dir() else package.parent / "conf"


def in_quotes(value: str) -> str:
    """Quote a string for Hydra's grammar."""
    return "'" + re.sub(r"(\\+)(?='|\Z)", r"\1\1", value).replace("'", "\\'") + "'"  # backslashes escape only quotes


def without_quotes(value: str) -> str:
    """Remove quotes around a value."""
    return re.sub(r"""\A(['"])(.*)\1\Z""", r"\2", value, flags=re.DOTALL)


def to_hydra_syntax(argument: str) -> str:
    """Return an override in Hydra's grammar: a path in quotes, an experiment file as an option relative to `conf/`."""
    key, equals, value = argument.partition("=")
    if key == "experiment" and value.endswith(".yaml"):
        path = Path(value).expanduser()
        if not path.is_file():
            raise ConfigError(f"{argument}: there is no such file")
        value = os.path.relpath(path.resolve().with_suffix(""), config_dir() / "experiment")
    elif not equals or "/" not in value or key.startswith("-"):
        return argument
    else:
        with suppress(HydraException):  # a path that Hydra can't parse is quoted below
            OverridesParser.create().parse_override(argument)
            return argument
    return f"{key}={in_quotes(value)}"


def is_hydra_override(override: str) -> bool:
    """Return whether an override changes Hydra's own config, e.g. its launcher."""
    return re.match(r"[+~]*hydra\b", override) is not None


def hydra_overrides(overrides: Iterable[str]) -> list[str]:
    """Return the overrides that choose and set up the launcher."""
    others = re.compile(r"[+~]*hydra[./](sweeper|mode|run|sweep|help)\b")
    return [override for override in overrides if is_hydra_override(override) and not others.match(override)]


def parse_overrides(overrides: Iterable[str]) -> list[Override]:
    """Parse overrides, within `hydra_ready`."""
    parsed = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader()).parse_overrides([*overrides])
    for override in parsed:
        if not override.key_or_group:
            raise ConfigError(f"{override.input_line}: there is no key before the equals sign; write KEY=VALUE")
    return parsed


def axes_of(overrides: Iterable[str]) -> dict[str, list[str]]:
    """Return the values of each key, in Hydra's syntax; of a key that is overridden twice, the last."""
    axes = {}
    for override in parse_overrides(overrides):
        values = [] if override.is_sweep_override() else [override.get_value_element_as_str()]
        if override.is_discrete_sweep():
            values = list(override.sweep_string_iterator())
        if not values:
            raise ConfigError(f"{override.input_line}: there are no values to sweep over")
        if override.key_or_group == "label":  # to be found in the cells of an experiment, which have no escapes
            values = [str(one.value()) for one in parse_overrides(f"label={value}" for value in values)]
        axes[override.get_key_element()] = values
    if "seed" in axes and axes.get("seeds", ["null"]) != ["null"]:
        raise ConfigError("seed and seeds are both given; seeds=[...] names several")
    return axes

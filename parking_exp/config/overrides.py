"""Command-line overrides in Hydra's grammar: quoting, parsing, the values of each key."""

import math
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, RangeSweep
from hydra.errors import HydraException

from parking_exp.config.paths import absolute_path
from parking_exp.errors import ConfigError, first_line

MAX_VALUES = 100_000  # most values of a range
# A quoted text, or what stands between commas.
WORD = re.compile(r"""(["'])(?:\\.|(?!\1).)*\1|[^][(),]+""")


def conf_dir() -> Path:
    """Return the Hydra tree's directory: the package's in a wheel, else at the repository's top."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "conf"
    return inside if inside.is_dir() else package.parent / "conf"


def in_quotes(value: str) -> str:
    """Quote a string for Hydra's grammar."""
    # Backslashes escape only quotes.
    return "'" + re.sub(r"(\\+)(?='|\Z)", r"\1\1", value).replace("'", "\\'") + "'"


def without_quotes(value: str) -> str:
    """Remove quotes around a value."""
    return re.sub(r"""\A(['"])(.*)\1\Z""", r"\2", value, flags=re.DOTALL)


def to_hydra_syntax(argument: str) -> str:
    """Return an override in Hydra's grammar: quoted paths, experiment files relative to `conf/`."""
    key, equals, value = argument.partition("=")
    if key == "experiment" and value.endswith(".yaml"):
        path = absolute_path(value)
        if not path.is_file():
            raise ConfigError(f"{argument}: there is no such file")
        value = os.path.relpath(path.resolve().with_suffix(""), conf_dir() / "experiment")
    elif not equals or "/" not in value or key.startswith("-"):
        return argument
    else:
        with suppress(HydraException, ValueError):  # a path that Hydra can't parse is quoted below
            OverridesParser.create().parse_override(argument)
            return argument
    return f"{key}={in_quotes(value)}"


def is_hydra_override(override: str) -> bool:
    """Return whether an override changes Hydra's own config, e.g. its launcher."""
    return re.match(r"[+~]*hydra\b", override) is not None


def parse_overrides(overrides: Iterable[str]) -> list[Override]:
    """Parse overrides, within `hydra_ready`."""
    parser = OverridesParser.create(GlobalHydra.instance().config_loader())
    parsed: list[Override] = []
    for text in overrides:
        try:
            parsed += parser.parse_overrides([text])
        except ValueError as error:  # a number of thousands of digits, which Python does not read
            key = text.partition("=")[0]
            raise ConfigError(f"{key}: {first_line(error).partition(';')[0]}") from error
        if not parsed[-1].key_or_group:
            raise ConfigError(f"{text}: there is no key before the equals sign; write KEY=VALUE")
    return parsed


def numbers_as_text(value: str) -> str:
    """Quote words of a value that Hydra would read as numbers or booleans: `0.10` stays `0.10`."""

    def quote(match: re.Match[str]) -> str:
        word = match[0].strip()
        if match[1] or not word:
            return match[0]
        with suppress(HydraException, ValueError):
            override = OverridesParser.create().parse_override(f"label={word}")
            if isinstance(override.value(), int | float):
                return in_quotes(word)
        return match[0]

    return WORD.sub(quote, value)


def axes_of(overrides: Iterable[str]) -> dict[str, list[str]]:
    """Return the values of each key in Hydra's syntax; the last override of a key counts."""
    axes = {}
    for override in parse_overrides(map(_labels_as_text, overrides)):
        _refuse_long_range(override)
        values = [] if override.is_sweep_override() else [override.get_value_element_as_str()]
        if override.is_discrete_sweep():
            values = list(override.sweep_string_iterator())
        if not values:
            raise ConfigError(f"{override.input_line}: there are no values to sweep over")
        if override.key_or_group == "label":
            # As the cells of an experiment have them, without escapes.
            labels = parse_overrides(f"label={numbers_as_text(value)}" for value in values)
            values = [_label_text(label) for label in labels]
        axes[override.get_key_element()] = values
    if "seed" in axes and axes.get("seeds", ["null"]) != ["null"]:
        raise ConfigError("seed and seeds are both given; seeds=[...] names several")
    return axes


def _labels_as_text(override: str) -> str:
    key, equals, value = override.partition("=")
    has_labels = equals and key.lstrip("+") in ("label", "contrasts")
    return f"{key}={numbers_as_text(value)}" if has_labels else override


def _label_text(override: Override) -> str:
    label = override.value()
    if label is not None and not isinstance(label, str):
        raise ConfigError(f"{override.input_line}: a label is text; write \"label='...'\"")
    return "null" if label is None else label


def _refuse_long_range(override: Override) -> None:
    """Refuse a range of more values than a sweep can have, before they are listed."""
    sweep = override.value()
    if not isinstance(sweep, RangeSweep) or sweep.start is None or sweep.stop is None:
        return
    if not sweep.step:
        raise ConfigError(f"{override.input_line}: the step of a range can't be 0")
    n_values = (sweep.stop - sweep.start) // sweep.step
    if math.isnan(n_values) or n_values > MAX_VALUES:
        raise ConfigError(
            f"{override.input_line}: a sweep has at most {MAX_VALUES} values of a key"
        )

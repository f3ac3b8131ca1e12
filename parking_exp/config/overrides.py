"""Command-line overrides in Hydra's grammar: quoting them, reading their values, and checking the names in them."""

from collections.abc import Callable, Iterable, Sequence, Set
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf

from parking_exp.config.cell_labels import settings_of
from parking_exp.config.grid import seeds_of, written
from parking_exp.config.messages import NUMBER_RANGE
from parking_exp.errors import ConfigError, did_you_mean, suggestion

OptionsOf = Callable[[str], list[str]]
"""Returns the options of a group; none of what is no group."""


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


def hydra_overrides(overrides: list[str]) -> list[str]:
    """Return the overrides that choose and set up the launcher."""
    parsed = OverridesParser.create().parse_overrides(overrides)
    others = ("hydra.sweeper", "hydra/sweeper", "hydra.mode", "hydra.run", "hydra.sweep", "hydra/help", "hydra.help")
    return [
        str(override.input_line)
        for override in parsed
        if is_hydras(override.key_or_group) and not override.key_or_group.startswith(others)
    ]


def is_hydras(key: str) -> bool:
    """Whether a key or group is of Hydra itself."""
    return key == "hydra" or key.startswith(("hydra.", "hydra/"))


def is_launchers(key: str) -> bool:
    """Whether a key or group is of Hydra's launcher."""
    return key.startswith(("hydra/launcher", "hydra.launcher"))


def is_group(override: Override, options_of: OptionsOf) -> bool:
    """Whether an override chooses an option of a group."""
    return bool(options_of(override.key_or_group))


def typed_seeds(overrides: list[Override]) -> list[int] | None:
    """Read `seeds=5`, `seeds=[3,4]` or `seeds=3,4`; return [] for `seeds=null`, and None where none are passed."""
    for override in reversed(overrides):
        if override.key_or_group == "seeds":
            return seeds_of(list(override.sweep_iterator()) if override.is_sweep_override() else override.value()) or []
    return None


def typed_values(overrides: list[Override]) -> dict[str, list[str]]:
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
    if "seed" in found and found.get("seeds", ["null"]) != ["null"]:
        raise ConfigError("seed and seeds are both given; seeds=[...] names several")
    return found


def first_values(overrides: Iterable[Override]) -> list[str]:
    """Return overrides as typed, with the first value of each swept one."""
    lines = []
    for override in overrides:
        if override.is_sweep_override():
            lines.append(f"{override.get_key_element()}={next(iter(override.sweep_string_iterator()))}")
        else:
            lines.append(str(override.input_line))
    return lines


def expand_groups(overrides: list[str], parser: OverridesParser, options_of: OptionsOf) -> list[Override]:
    """Parse overrides; those that set several keys of a group, `tracking={csv: false}`, become one for each key."""
    found = []
    for line in overrides:
        try:
            (override,) = parser.parse_overrides([line])
        except ValueError as error:  # Python reads no integer of so many digits
            key = line.partition("=")[0]
            raise ConfigError(f"{key}: a number has too many digits; {NUMBER_RANGE}") from error
        values = override.value()
        if override.type == OverrideType.CHANGE and isinstance(values, dict) and is_group(override, options_of):
            lines = [f"{override.key_or_group}.{key}={written(value)}" for key, value in values.items()]
            found += parser.parse_overrides(lines)
        else:
            found.append(override)
    return found


def check_groups(overrides: Sequence[Override], groups: Set[str], options_of: OptionsOf) -> None:
    """Check that groups and options exist.

    Raises:
        ConfigError: with the closest name.
    """
    for override in overrides:
        name = override.key_or_group
        if not name:
            raise ConfigError(f"{override.input_line}: there is no key before the equals sign; write KEY=VALUE")
        if name in ("hydra", "hydra.launcher"):
            raise ConfigError(f"{override.input_line}: {name} is a group of keys; write {name}.KEY=VALUE")
        if (is_hydras(name) and name != "hydra/launcher") or not is_group(override, options_of):
            continue
        if name not in groups and not is_hydras(name):
            raise ConfigError(f"{name}: there is no such group here{suggestion(name, groups)}")
        if override.type != OverrideType.DEL:
            # Ray's launcher brings `ray_aws`, whose nodes do not share output_dir.
            _check_options(override, [option for option in options_of(name) if option != "ray_aws"])


def _check_options(override: Override, options: list[str]) -> None:
    name, values = override.key_or_group, [override.value()]
    if override.package is not None:
        raise ConfigError(f"{override.input_line}: options have their place; write {name}=OPTION")
    if override.is_sweep_override():
        values = list(override.sweep_string_iterator())
    for value in values[0] if isinstance(values[0], list) else values:
        if value is None:
            raise ConfigError(f"{name}=null: leave it out, or choose from {', '.join(options)}")
        if str(value).startswith("{"):  # several keys of the group, which Hydra takes as such
            continue
        if str(value) not in options:
            raise ConfigError(f"{name}={value}: there is no such option{suggestion(str(value), options)}")


def check_keys(base: DictConfig, overrides: Sequence[Override], groups: Set[str], options_of: OptionsOf) -> None:
    """Check that the config of the chosen options has the keys that are changed or deleted.

    Keys of a group whose options are swept over are checked with each of its options, where cells are composed.

    Raises:
        ConfigError: with the closest name.
    """
    swept = {override.key_or_group for override in overrides if override.is_sweep_override()}
    for override in overrides:
        is_key = not is_hydras(override.key_or_group) and not is_group(override, options_of)
        group, dot, _ = override.key_or_group.partition(".")
        if is_key and override.type in {OverrideType.CHANGE, OverrideType.DEL} and not (dot and group in swept):
            _check_key(base, override, groups)


def _check_key(base: DictConfig, override: Override, groups: Set[str]) -> None:
    node: object = base
    parts = override.key_or_group.split(".")
    for depth, part in enumerate(parts):
        known = [str(key) for key in node] if isinstance(node, DictConfig) else []
        if part not in known:
            parent = ".".join(parts[:depth])
            if "_target_" in known and not did_you_mean(part, known):
                raise ConfigError(
                    f"{override.key_or_group}: there is no such key in the YAML of {parent}; if it is an argument of "
                    f"{parent}._target_, write +{override.input_line}"
                )
            if parent and isinstance(node, DictConfig) and not known:
                raise ConfigError(f"{override.key_or_group}: {parent} is empty so far; write +{override.input_line}")
            if not parent and part in groups:
                raise ConfigError(f"{part}: no option is chosen; write {part}=OPTION {override.input_line}")
            everything: Any = OmegaConf.to_container(base)
            inside = [key for key in settings_of(everything) if f".{part}." in f"{key}."]
            if not parent and inside:  # the group was forgotten
                place = inside[0][: f"{inside[0]}.".index(f".{part}.")]
                raise ConfigError(f"{part}: there is no such key; did you mean '{place}.{part}'?")
            choices = {*known, *([] if parent else groups)}
            if "experiment_name" in known:
                choices.add("experiment")  # status.py and report.py have replaced it by that key already
            raise ConfigError(f"{override.key_or_group}: there is no such key{suggestion(part, choices)}")
        assert isinstance(node, DictConfig)
        node = node._get_node(part) if node._is_none() else node[part]

"""Labels of cells: what differs in their configs, in plans, status and reports alike.

Only resolved configs count, not what was passed. A group's option (`algorithm=td3`) changes many keys at once:
those that follow from it alone are no factors of their own. Keys that always change together count once.
"""

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from parking_exp.config.run_key import changes_results

Setting = str | int | float | bool | None
Config = Mapping[str, Setting]
"""Dotted keys -> values of one cell."""

GROUPS = ("env", "algorithm", "buffer")
EXPERIMENT = "experiment"
# As many distinct values as cells is what drawing from a range gives; below this many cells it says nothing.
FEW_CELLS = 5


@dataclass(frozen=True)
class Factor:
    """A key that differs between cells."""

    key: str  # e.g. `buffer.n_sampled_goal`, or a group such as `buffer`
    name: str  # short, for axes: `n_sampled_goal`
    levels: Sequence[Setting]  # numbers in order
    numeric: bool  # whether all levels are numbers
    log: bool = False  # whether an axis is better logarithmic


def settings_of(config: Mapping[str, Any], prefix: str = "") -> dict[str, Setting]:
    """Return a nested config as dotted keys, with lists as text, as stores have it."""
    flat: dict[str, Setting] = {}
    for key, value in config.items():
        if isinstance(value, Mapping) and value:
            flat |= settings_of(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = str(value) if isinstance(value, list | dict) else value
    return flat


def can_matter(key: str) -> bool:
    """Whether a key can change a result, and is no seed."""
    return key != "seed" and changes_results(key)


def differing(configs: Sequence[Config]) -> list[str]:
    """Return the keys that can change a result and are not the same in all configs."""
    keys = sorted({key for config in configs for key in config if can_matter(key)})
    return [key for key in keys if len({hashable(config.get(key)) for config in configs}) > 1]


def find_factors(
    configs: Sequence[Config], experiments: Sequence[str]
) -> tuple[list[Factor], list[dict[str, Setting]]]:
    """Return the factors of cells, given the config and the experiment of each, and each cell's settings.

    Settings are factor's key -> value; None where a cell has no such key.
    """
    varying, columns = differing(configs), dict[str, list[Setting]]()
    if len(set(experiments)) > 1:
        columns[EXPERIMENT] = list(experiments)
    for group in GROUPS:
        if f"{group}.name" in varying:
            columns[group] = [config.get(f"{group}.name") for config in configs]
            varying.remove(f"{group}.name")
    options = list(columns.values())
    # How a run was evaluated is no factor unless there is nothing else. Of keys that change together, one of the run
    # itself stands for those of a group: `n_envs` for the warm-up that it needs.
    for key in sorted(varying, key=lambda key: (key.startswith("evaluation."), "." in key)):
        values = [config.get(key) for config in configs]
        if not any(_follows(values, column) for column in options) and not _doubles(values, columns.values()):
            columns[key] = _with_null(key, values, configs)
    factors = [_factor(key, _short_name(key, columns), values) for key, values in columns.items()]
    return factors, [{key: values[cell] for key, values in columns.items()} for cell in range(len(configs))]


def label_by_experiment(configs: Mapping[tuple[str, str], Config]) -> dict[tuple[str, str], str]:
    """Return the label of each cell among those of its experiment, given configs by (experiment, cell)."""
    labels: dict[tuple[str, str], str] = {}
    for experiment in dict.fromkeys(experiment for experiment, _ in configs):
        own = [key for key in configs if key[0] == experiment]
        labels |= zip(own, label_cells([configs[key] for key in own], [cell for _, cell in own]), strict=True)
    return labels


def label_cells(configs: Sequence[Config], names: Sequence[str]) -> list[str]:
    """Return the labels of the cells of an experiment, given their configs and names.

    A cell that is alone is called after its algorithm and buffer.
    """
    if len(configs) == 1:
        options = [str(configs[0][f"{group}.name"]) for group in GROUPS[1:] if f"{group}.name" in configs[0]]
        return [", ".join(options) or names[0]]
    return cell_labels(*find_factors(configs, [""] * len(configs)), names)


def cell_labels(
    factors: Sequence[Factor], settings: Sequence[Mapping[str, Setting]], names: Sequence[str]
) -> list[str]:
    """Return what sets each cell apart, e.g. `her_final, n_sampled_goal=8`: groups by their option alone.

    Labels that would be the same get the key that ends their cell's name.
    """
    prefixes = {factor.key: "" if factor.key in (*GROUPS, EXPERIMENT) else f"{factor.name}=" for factor in factors}
    labels = [
        ", ".join(prefix + setting(cell[key]) for key, prefix in prefixes.items() if cell[key] is not None)
        for cell in settings
    ]
    parts = [name.rpartition("-") for name in names]
    return [
        label if label and labels.count(label) == 1 else f"{label or option} ({key})"
        for label, (option, _, key) in zip(labels, parts, strict=True)
    ]


def setting(value: Any) -> str:
    """Write a config value as YAML would."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def hashable(value: Setting) -> Hashable:
    """Return a setting as a set can hold it."""
    # 1 and True, 1 and 1.0 are the same to a dict; True is another setting than 1.
    return (isinstance(value, bool), value)


def _factor(key: str, name: str, values: Sequence[Setting]) -> Factor:
    levels: list[Any] = list({hashable(value): value for value in values if value is not None}.values())
    numeric = bool(levels) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in levels)
    if numeric:
        levels.sort()
    return Factor(key, name, levels, numeric, log=numeric and levels[0] > 0 and levels[-1] >= 8 * levels[0])


def _short_name(key: str, keys: Collection[str]) -> str:
    """Return the shortest ending of a key that no other one has."""
    parts = key.split(".")
    endings = (".".join(parts[start:]) for start in reversed(range(len(parts))))
    return next((e for e in endings if sum(f".{other}".endswith(f".{e}") for other in keys) == 1), key)


def _follows(values: Sequence[Setting], column: Sequence[Setting]) -> bool:
    """Whether each value of a column comes with one value only."""
    options = list(map(hashable, column))
    return len(set(zip(options, map(hashable, values), strict=True))) == len(set(options))


def _doubles(values: Sequence[Setting], columns: Iterable[Sequence[Setting]]) -> bool:
    """Whether a key changes exactly where another does. In a search all do: every cell has values of its own."""
    if len(set(map(hashable, values))) == len(values) >= FEW_CELLS:
        return False
    return any(_follows(values, column) and _follows(column, values) for column in columns)


def _with_null(key: str, values: Sequence[Setting], configs: Sequence[Config]) -> list[Setting]:
    """Tell null from not there: where the same option of the group has a value in another cell, it is null."""
    options = [hashable(config.get(f"{key.partition('.')[0]}.name")) for config in configs]
    having = {option for option, value in zip(options, values, strict=True) if value is not None}
    return [
        "null" if value is None and option in having else value for option, value in zip(options, values, strict=True)
    ]

"""Label cells by the differences between their resolved configs, in plans, status and reports.

A group's option (`algorithm=td3`) changes many keys at once: keys that it determines are not
separate factors. Keys that always change together count once. A `label` in the configs takes the
place of all keys that it determines. Keys that stored configs leave out have their defaults.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from parking_exp.config.settings import (
    FlatConfig,
    Setting,
    differing_keys,
    display_setting,
    hashable,
    with_defaults,
)

GROUPS = ("env", "algorithm", "buffer")
EXPERIMENT = "experiment"
LABEL = "label"
MIN_DRAWN_CELLS = 5  # from this number of cells on, distinct values count as draws from a range


@dataclass(frozen=True)
class Factor:
    """A key that differs between cells."""

    key: str  # e.g. `buffer.n_sampled_goal`, or a group such as `buffer`
    name: str  # short, for axes: `n_sampled_goal`
    levels: Sequence[Setting]  # numbers in order
    numeric: bool  # whether all levels are numbers


def find_factors(
    configs: Sequence[FlatConfig], experiments: Sequence[str] = ()
) -> tuple[list[Factor], list[dict[str, Setting]]]:
    """Return the factors of cells from their configs and experiments, and their values by cell.

    Without `experiments`, all cells belong to one. The value is None if a cell's config has no such
    key.
    """
    complete = [with_defaults(config) for config in configs]
    columns = _option_columns(complete, experiments)
    grouped = {f"{group}.name" for group in GROUPS}
    varying = [key for key in differing_keys(complete) if key not in grouped]
    _add_key_columns(columns, varying, complete)
    factors = [_factor(key, values, columns) for key, values in columns.items()]
    settings = []
    for number in range(len(configs)):
        settings.append({key: values[number] for key, values in columns.items()})
    return factors, settings


def _option_columns(
    configs: Sequence[FlatConfig], experiments: Sequence[str]
) -> dict[str, list[Setting]]:
    """Return the experiments, labels and options of groups by cell, where they differ."""
    columns: dict[str, list[Setting]] = {}
    if len(set(experiments)) > 1:
        columns[EXPERIMENT] = list(experiments)
    labels = [config.get(LABEL) for config in configs]
    if len(set(labels)) > 1:
        columns[LABEL] = labels
    for group in GROUPS:
        options = [config.get(f"{group}.name") for config in configs]
        is_labelled = LABEL in columns and _is_determined_by(options, labels)
        if len(set(options)) > 1 and not is_labelled:
            columns[group] = options
    return columns


def _add_key_columns(
    columns: dict[str, list[Setting]], varying: Sequence[str], configs: Sequence[FlatConfig]
) -> None:
    """Add the values of those keys that no column determines."""
    options = list(columns.values())
    rows = [tuple(hashable(config.get(key)) for key in varying) for config in configs]
    n_distinct = len(set(rows))
    for key in sorted(varying, key=_rank):
        values = [config.get(key) for config in configs]
        if any(_is_determined_by(values, column) for column in options):
            continue
        # In a search all keys change together, since the values of each are drawn from a range.
        n_values = len(set(map(hashable, values)))
        is_drawn = n_values == n_distinct and n_distinct >= MIN_DRAWN_CELLS
        if is_drawn or not any(_change_together(values, column) for column in columns.values()):
            columns[key] = _with_null(key, values, configs)


def _rank(key: str) -> tuple[bool, bool]:
    """Return the sort key of a key; the first of several keys that change together represents them.

    Top-level keys come first, then keys of groups, then evaluation keys: `n_envs` represents the
    warm-up that it requires.
    """
    return key.startswith("evaluation."), "." in key


def label_by_experiment(
    configs: Mapping[tuple[str, str], FlatConfig],
) -> dict[tuple[str, str], str]:
    """Return the label of each cell within its experiment, given configs by (experiment, name)."""
    labels: dict[tuple[str, str], str] = {}
    for experiment in dict.fromkeys(experiment for experiment, _ in configs):
        keys = [key for key in configs if key[0] == experiment]
        names = [name for _, name in keys]
        texts = label_cells([configs[key] for key in keys], names)
        labels |= zip(keys, texts, strict=True)
    return labels


def label_cells(configs: Sequence[FlatConfig], names: Sequence[str]) -> list[str]:
    """Return the labels of an experiment's cells.

    A single cell without a label of its own is called by its algorithm, and by its buffer if it is
    trained.
    """
    if len(configs) > 1:
        factors, settings = find_factors(configs)
        return labels_from_factors(factors, settings, names)
    (config,) = configs
    groups = ["algorithm", "buffer"]
    if config.get("total_timesteps") == 0:
        groups.remove("buffer")
    options = [config.get(f"{group}.name") for group in groups]
    text = ", ".join(str(option) for option in options if option is not None)
    return [str(config.get(LABEL) or text or names[0])]


def labels_from_factors(
    factors: Sequence[Factor], settings: Sequence[Mapping[str, Setting]], names: Sequence[str]
) -> list[str]:
    """Return unique labels such as `her_final, n_sampled_goal=8`.

    Equal and empty labels get the key at the end of the cell's name.
    """
    texts = [label_factors(factors, values) for values in settings]
    labels = []
    for text, name in zip(texts, names, strict=True):
        if text and texts.count(text) == 1:
            labels.append(text)
        else:
            option, _, key = name.rpartition("-")
            labels.append(f"{text or option} ({key})")
    return labels


def label_factors(factors: Sequence[Factor], settings: Mapping[str, Setting]) -> str:
    """Return the values of a cell's factors, e.g. `her_final, n_sampled_goal=8`."""
    parts = []
    for factor in factors:
        value = settings[factor.key]
        if value is None:
            continue
        is_option = factor.key in (*GROUPS, EXPERIMENT, LABEL)
        prefix = "" if is_option else f"{factor.name}="
        parts.append(prefix + display_setting(value))
    return ", ".join(parts)


def _factor(key: str, values: Sequence[Setting], keys: Collection[str]) -> Factor:
    """Return the factor of a key, named by the shortest ending of it that is unique among keys."""
    distinct = {hashable(value): value for value in values if value is not None}
    levels: list[Any] = list(distinct.values())
    numbers = [
        level for level in levels if isinstance(level, int | float) and not isinstance(level, bool)
    ]
    numeric = bool(levels) and len(numbers) == len(levels)
    if numeric:
        levels.sort()
    return Factor(key, _short_name(key, keys), levels, numeric)


def _short_name(key: str, keys: Collection[str]) -> str:
    """Return the shortest ending of a key that is unique among keys, or else the key."""
    parts = key.split(".")
    for n_parts in range(1, len(parts)):
        ending = ".".join(parts[-n_parts:])
        with_ending = [other for other in keys if f".{other}".endswith(f".{ending}")]
        if len(with_ending) == 1:
            return ending
    return key


def _is_determined_by(values: Sequence[Setting], column: Sequence[Setting]) -> bool:
    """Return whether a column determines values."""
    options = list(map(hashable, column))
    return len(set(zip(options, map(hashable, values), strict=True))) == len(set(options))


def _change_together(values: Sequence[Setting], column: Sequence[Setting]) -> bool:
    """Return whether values and a column determine each other."""
    return _is_determined_by(values, column) and _is_determined_by(column, values)


def _with_null(key: str, values: Sequence[Setting], configs: Sequence[FlatConfig]) -> list[Setting]:
    """Return the values of a key, with "null" for the cells that set it to null.

    Stored configs leave null out, so that it looks like a missing key. A cell has the key if any
    cell with the same option of the key's group has a value.
    """
    options = [config.get(f"{key.partition('.')[0]}.name") for config in configs]
    pairs = list(zip(options, values, strict=True))
    options_with_key = [option for option, value in pairs if value is not None]
    shown: list[Setting] = []
    for option, value in pairs:
        is_null = value is None and option in options_with_key
        shown.append("null" if is_null else value)
    return shown

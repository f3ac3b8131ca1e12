"""Group runs into labelled cells, and select those that were asked for."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.config.cell_labels import (
    GROUPS,
    Config,
    Factor,
    Setting,
    can_matter,
    cell_labels,
    find_factors,
    label_cells,
    setting,
)
from parking_exp.errors import ConfigError, suggestion
from parking_exp.results.dtypes import typed

CONFIG = "config."


@dataclass(frozen=True)
class Group:
    """The runs of one cell.

    Attributes:
        experiment, name: as in the store.
        label: what sets it apart from the others of the report.
        settings: value of each factor, see `factors.find_factors`.
        config: dotted key -> value.
        runs: rows of `Results.runs`, by seed; of two runs with the same seed, the one that is done, or is newer.
        repeated: how many runs were left out for another one with the same seed.
    """

    experiment: str
    name: str
    label: str
    settings: dict[str, Setting]
    config: Config
    runs: pd.DataFrame
    repeated: int

    @cached_property
    def done(self) -> pd.DataFrame:
        """The finished runs."""
        return self.runs[self.runs["status"] == "done"]


def group(runs: pd.DataFrame) -> tuple[list[Group], list[Factor]]:
    """Return the cells of some runs, in the order of their factors' levels, and these factors.

    Levels that are numbers are in the order of these, others in the order in which they were begun.
    """
    keys = [str(column) for column in runs if str(column).startswith(CONFIG)]
    begun = runs.sort_values("started", kind="stable", ignore_index=True)
    rest = begun.drop(columns=keys)  # narrow ones are faster
    tables = [table for _, table in rest.groupby(["experiment", "cell"], sort=False)]
    values = dict(zip(keys, begun[keys].astype(object).to_numpy().T, strict=True))
    configs = [_config(values, table.index[0]) for table in tables]
    experiments = [str(table["experiment"].iloc[0]) for table in tables]
    names = [str(table["cell"].iloc[0]) for table in tables]
    factors, settings = find_factors(configs, experiments)
    labels = cell_labels(factors, settings, names) if len(tables) > 1 else label_cells(configs, names)
    found = []
    for number, text in enumerate(labels):
        once = _one_a_seed(tables[number])
        found.append(
            Group(
                experiment=experiments[number],
                name=names[number],
                label=text,
                settings=settings[number],
                config=configs[number],
                runs=once,
                repeated=len(tables[number]) - len(once),
            )
        )
    return _in_order(found, factors), factors


def choose(groups: Sequence[Group], asked: Sequence[str], key: str = "cells") -> list[Group]:
    """Return the cells that were asked for.

    Args:
        groups: all cells.
        asked: labels, names or patterns of them (`her_*`), any of which may fit; and `KEY=VALUE,VALUE`, all of which
            have to: a group, a config key or the end of one, and the values it may have.
        key: what was typed, for errors.

    Raises:
        ConfigError: one of them fits nothing.
    """
    patterns = [one for one in asked if "=" not in one or _called(groups, one)]
    narrowing = [one for one in asked if one not in patterns]
    found = list(groups)
    if patterns:
        wanted = set()
        for pattern in patterns:
            if not (fitting := _matching(groups, pattern)):
                hint = suggestion(pattern, [one.label for one in groups])
                raise ConfigError(f"{key}: no cell is called {pattern!r}{hint}")
            wanted |= {id(one) for one in fitting}
        found = [one for one in groups if id(one) in wanted]
    for condition in narrowing:
        found = _narrowed(found, groups, condition)
    if not found:
        raise ConfigError(f"{key}: no cell fits all of {', '.join(asked)}")
    return found


def one_cell(groups: Sequence[Group], asked: str, preferred: Sequence[Group] = ()) -> Group:
    """Return the one cell that fits a label, a name or a pattern; where several do, the one that is preferred.

    Raises:
        ConfigError: none does, or several do.
    """
    found = _called(groups, asked) or choose(groups, [asked], "baseline")
    if len(found) > 1:
        found = [one for one in found if any(one is other for other in preferred)] or found
    if len(found) > 1:
        few = ", ".join(repr(one.label) for one in found[:5])
        raise ConfigError(f"baseline={asked}: {len(found)} cells fit, {few} among them; name one")
    return found[0]


def relabelled(groups: Sequence[Group]) -> tuple[list[Group], list[Factor]]:
    """Return cells with labels that say only what sets these apart."""
    factors, settings = find_factors([one.config for one in groups], [one.experiment for one in groups])
    names = [one.name for one in groups]
    if len(groups) == 1:
        return [replace(groups[0], settings=settings[0])], factors
    labels = cell_labels(factors, settings, names)
    return [
        replace(one, label=text, settings=setting) for one, text, setting in zip(groups, labels, settings, strict=True)
    ], factors


def _called(groups: Sequence[Group], name: str) -> list[Group]:
    return [one for one in groups if name in (one.label, one.name)]


def _matching(groups: Sequence[Group], pattern: str) -> list[Group]:
    parts = [(one, (one.label, one.name, *one.label.split(", "))) for one in groups]
    return _called(groups, pattern) or [
        one for one, words in parts if any(fnmatchcase(word, pattern) for word in words)
    ]


def _narrowed(groups: list[Group], everyone: Sequence[Group], condition: str) -> list[Group]:
    typed_key, _, wanted = condition.partition("=")
    keys = dict.fromkeys(key for one in everyone for key in one.config if can_matter(key))
    name = _whole_key(typed_key, keys)
    if name is None:
        choices = {*GROUPS, "experiment", "baseline", "cells", "name", "output_dir", "tracking.uri", "report", *keys}
        hint = suggestion(typed_key, choices)
        raise ConfigError(f"{typed_key}: neither a key of this command nor of these runs' configs{hint}")
    there = {_bare(setting(one.config[name])) for one in everyone if name in one.config}
    values = {_bare(wanted)} & there or {_bare(setting(typed(one.strip()))) for one in _listed(wanted)}
    if unknown := sorted(values - there):
        raise ConfigError(f"{typed_key}={unknown[0]}: no run has that{suggestion(unknown[0], there)}")
    return [one for one in groups if name in one.config and _bare(setting(one.config[name])) in values]


def _whole_key(typed_key: str, keys: Iterable[str]) -> str | None:
    """Return the config key that is meant by a group, a key, or the end of one that there is once."""
    exact = f"{typed_key}.name" if typed_key in GROUPS else typed_key
    found = [key for key in keys if key == exact] or [key for key in keys if key.endswith(f".{typed_key}")]
    return found[0] if len(found) == 1 else None


def _listed(text: str) -> list[str]:
    """Split values at commas, those within brackets excepted; brackets around all of them are only a list's."""
    inner = text[1:-1] if text.startswith("[") and text.endswith("]") else text
    return re.split(r",(?![^\[]*\])", inner)


def _bare(text: str) -> str:
    return text.replace(" ", "")


def _in_order(groups: Sequence[Group], factors: Sequence[Factor]) -> list[Group]:
    def place(one: Group) -> list[int]:
        levels = [(one.settings[factor.key], list(factor.levels)) for factor in factors]
        return [len(known) if level is None else known.index(level) for level, known in levels]

    return sorted(groups, key=place)


def _config(columns: Mapping[str, np.ndarray], row: int) -> dict[str, Setting]:
    """Return the config of a run. Frames do not tell a key that is null from one that is not there."""
    known = {key.removeprefix(CONFIG): values[row] for key, values in columns.items()}
    return {key: _plain(value) for key, value in known.items() if not pd.isna(value)}


def _plain(value: Any) -> Setting:
    plain = value.item() if isinstance(value, np.generic) else value
    return str(plain) if isinstance(plain, float) and math.isinf(plain) else plain  # JSON has no infinity


def _one_a_seed(table: pd.DataFrame) -> pd.DataFrame:
    rank = (table["status"] == "done").astype(int)
    ordered = table.assign(_rank=rank).sort_values(["seed", "_rank", "started"], kind="stable")
    return ordered.drop_duplicates("seed", keep="last").drop(columns="_rank")

"""Group runs into labelled cells, and select some of them by label, pattern or config."""

import ast
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from pydantic import TypeAdapter

from parking_exp.config.cell_labels import (
    GROUPS,
    LABEL,
    Config,
    Factor,
    Setting,
    can_matter,
    find_factors,
    hashable,
    label_cells,
    labels_from_factors,
    setting,
)
from parking_exp.config.overrides import without_quotes
from parking_exp.errors import ConfigError, suggestion
from parking_exp.reports import report_request

CONFIG = "config."
CONTRASTS = TypeAdapter(list[tuple[str, str]] | None)


@dataclass(frozen=True, eq=False)
class CellRuns:
    """The runs of one cell."""

    experiment: str
    name: str
    label: str  # what distinguishes it from the others of the report
    settings: dict[str, Setting]  # value of each factor
    config: Config
    runs: (
        pd.DataFrame
    )  # rows of `Results.runs` by seed; of runs with equal seeds, the one that is done, or is newer
    n_repeated: int  # runs left out for another one with the same seed

    @property
    def task(self) -> str:
        """Name of its task; configs of early exports have parking alone."""
        return str(self.config.get("env.task", "parking"))

    @property
    def begun(self) -> pd.Timestamp:
        """When its first run was started."""
        return self.runs["started"].min()

    @cached_property
    def done(self) -> pd.DataFrame:
        """The finished runs."""
        return self.runs[self.runs["status"] == "done"]


def group(runs: pd.DataFrame) -> list[CellRuns]:
    """Return the cells of some runs, in the order of their factors' levels.

    Levels that are numbers are in the order of these, others in the order in which they were begun.
    """
    keys = [str(column) for column in runs if str(column).startswith(CONFIG)]
    begun = runs.sort_values("started", kind="stable", ignore_index=True)
    configs = begun[keys].astype(object)
    has_config = configs.notna().any(axis=1)  # not if its file is damaged
    cells = []
    for (experiment, name), table in begun.drop(columns=keys).groupby(
        ["experiment", "cell"], sort=False
    ):
        newest = table.assign(done=table["status"] == "done").sort_values(
            ["seed", "done", "started"], kind="stable"
        )
        once = newest.drop_duplicates("seed", keep="last").drop(columns="done")
        with_config = [number for number in table.index if has_config[number]]
        first = with_config[0] if with_config else table.index[0]
        config = _read_config(configs.loc[first])
        cells.append(
            CellRuns(str(experiment), str(name), "", {}, config, once, len(table) - len(once))
        )
    labelled, factors = relabel(cells)
    levels = [[*factor.levels, None] for factor in factors]  # a control without the key comes last

    def level_indices(cell: CellRuns) -> list[int]:
        return [
            known.index(cell.settings[factor.key])
            for known, factor in zip(levels, factors, strict=True)
        ]

    return sorted(labelled, key=level_indices)


def relabel(cells: Sequence[CellRuns]) -> tuple[list[CellRuns], list[Factor]]:
    """Return cells with labels that distinguish these alone, and the factors."""
    factors, settings = find_factors(
        [cell.config for cell in cells], [cell.experiment for cell in cells]
    )
    if len(cells) == 1:
        (cell,) = cells
        label = cell.label or label_cells([cell.config], [cell.name])[0]
        return [replace(cell, label=label, settings=settings[0])], factors
    labels = labels_from_factors(factors, settings, [cell.name for cell in cells])
    return [
        replace(cell, label=label, settings=values)
        for cell, label, values in zip(cells, labels, settings, strict=True)
    ], factors


def choose(cells: Sequence[CellRuns], wanted: Sequence[str], key: str = "cells") -> list[CellRuns]:
    """Return the cells that fit any of the labels, names or patterns of them (`her_*`), and all
    `KEY=VALUE,VALUE`.

    KEY is a group, a config key or the end of one; the values are those it may have.
    """
    patterns = [text for text in wanted if "=" not in text or _find_named(cells, text)]
    selected = list(cells)
    if patterns:
        fitting = [cell for pattern in patterns for cell in _find_matching(cells, pattern, key)]
        selected = [cell for cell in cells if cell in fitting]
    for condition in wanted:
        if condition not in patterns:
            selected = _narrow(selected, cells, condition)
    if not selected:
        raise ConfigError(f"{key}: no cell fits all of {', '.join(wanted)}")
    return selected


def find_cell(
    cells: Sequence[CellRuns], name: str, key: str, preferred: Sequence[CellRuns] = ()
) -> CellRuns:
    """Return the one cell that fits a label, a name or a pattern; where several do, the one that is
    preferred.

    Raises:
        ConfigError: none fits, or several; it begins with `key`.
    """
    fitting = choose(cells, [name], key)
    if len(fitting) > 1:
        fitting = [cell for cell in fitting if cell in preferred] or fitting
    if len(fitting) > 1:
        few = ", ".join(repr(cell.label) for cell in fitting[:5])
        raise ConfigError(f"{key}={name}: {len(fitting)} cells fit, e.g. {few}; name one")
    return fitting[0]


def find_contrasts(
    cells: Sequence[CellRuns],
) -> tuple[list[tuple[CellRuns, CellRuns]], list[str], list[str]]:
    """Return the pairs that experiments declare as `contrasts`, those that name no cell, and
    warnings.

    Those of an experiment's first run count, and its cells are named as in a report on it alone.
    """
    contrasts, unknown, warnings = (
        dict[frozenset[int], tuple[CellRuns, CellRuns]](),
        list[str](),
        list[str](),
    )
    for experiment in dict.fromkeys(cell.experiment for cell in cells):
        own = sorted(
            (cell for cell in cells if cell.experiment == experiment), key=lambda cell: cell.begun
        )
        labelled = relabel(own)[0]
        try:
            named = CONTRASTS.validate_python(ast.literal_eval(str(own[0].config.get("contrasts"))))
        except (ValueError, SyntaxError, MemoryError, RecursionError):  # of a foreign store, or cut
            warnings.append(f"{experiment}: its contrasts can't be read.")
            continue
        for pair in named or ():
            try:
                first, second = (
                    own[labelled.index(find_cell(labelled, name, "contrasts"))] for name in pair
                )
            except ConfigError:
                unknown.append(" minus ".join(pair))
                continue
            if first is not second:
                contrasts.setdefault(frozenset((id(first), id(second))), (first, second))
    return list(contrasts.values()), unknown, warnings


def match_cells(
    cells: Sequence[CellRuns], factors: Sequence[Factor], contrast: str
) -> list[tuple[CellRuns, CellRuns]]:
    """Return the pairs of cells that differ in one factor alone, for a contrast
    `FACTOR:LEVEL-LEVEL`.

    A factor that one of the two cells does not have is not compared, such as `n_sampled_goal` of
    replay.

    Raises:
        ConfigError: there is no such factor or level, or no two cells match.
    """
    name, _, levels = contrast.partition(":")
    factor = next((factor for factor in factors if name in (factor.key, factor.name)), None)
    if factor is None:
        hint = suggestion(name, [factor.name for factor in factors])
        raise ConfigError(f"contrast={contrast}: these cells do not differ in {name!r}{hint}")
    first_level, second_level = _find_levels(factor, levels, contrast)
    first_cells = [
        cell for cell in cells if _normalise(setting(cell.settings[factor.key])) == first_level
    ]
    second_cells = [
        cell for cell in cells if _normalise(setting(cell.settings[factor.key])) == second_level
    ]
    others = [other.key for other in factors if other is not factor]
    pairs = []
    for first in first_cells:
        for second in second_cells:
            if first is not second and all(_is_matched(first, second, key) for key in others):
                pairs.append((first, second))
    if not pairs:
        raise ConfigError(
            f"contrast={contrast}: no two of these cells differ in {factor.name} alone"
        )
    return pairs


def _find_levels(factor: Factor, text: str, contrast: str) -> tuple[str, str]:
    """Return the two levels of `LEVEL-LEVEL`, which may have hyphens themselves."""
    known = {_normalise(setting(level)) for level in factor.levels}
    splits = [(text[: hyphen.start()], text[hyphen.end() :]) for hyphen in re.finditer("-", text)]
    for first, second in splits:
        if {_normalise(first), _normalise(second)} <= known:
            return _normalise(first), _normalise(second)
    if not splits:
        raise ConfigError(f"contrast={contrast}: write it as {factor.name}:LEVEL-LEVEL")
    closest = max(splits, key=lambda split: sum(_normalise(level) in known for level in split))
    unknown = next(level for level in closest if _normalise(level) not in known)
    hint = suggestion(unknown, map(setting, factor.levels))
    raise ConfigError(f"contrast={contrast}: {factor.name} has no level {unknown!r}{hint}")


def _is_matched(first: CellRuns, second: CellRuns, key: str) -> bool:
    levels = {hashable(first.settings[key]), hashable(second.settings[key])}
    return len(levels - {hashable(None)}) <= 1


def _find_named(cells: Sequence[CellRuns], name: str) -> list[CellRuns]:
    return [cell for cell in cells if name in (cell.label, cell.name)]


def _find_matching(cells: Sequence[CellRuns], pattern: str, key: str) -> list[CellRuns]:
    if named := _find_named(cells, pattern):
        return named
    names = [(cell, (cell.label, cell.name, *cell.label.split(", "))) for cell in cells]
    if fitting := [
        cell for cell, words in names if any(fnmatchcase(word, pattern) for word in words)
    ]:
        return fitting
    raise ConfigError(
        f"{key}: no cell is called {pattern!r}{suggestion(pattern, [cell.label for cell in cells])}"
    )


def _narrow(
    selected: Sequence[CellRuns], cells: Sequence[CellRuns], condition: str
) -> list[CellRuns]:
    """Return the selected cells whose config fits `KEY=VALUE,VALUE`."""
    name, _, text = condition.partition("=")
    keys = dict.fromkeys(
        key for cell in cells for key in cell.config if can_matter(key) or key == LABEL
    )
    exact = f"{name}.name" if name in GROUPS else name
    fitting = [exact] if exact in keys else [key for key in keys if key.endswith(f".{name}")]
    if len(fitting) != 1:
        hint = suggestion(name, {*GROUPS, *report_request.KEYS, *keys})
        raise ConfigError(f"{name}: neither a key of this command nor of these runs' configs{hint}")
    (key,) = fitting
    values = {
        _normalise(setting(cell.config[key])): setting(cell.config[key])
        for cell in cells
        if key in cell.config
    }
    whole = without_quotes(text)
    wanted = [
        _normalise(value)
        for value in ([whole] if _normalise(whole) in values else _split_values(text))
    ]
    if unknown := [value for value in wanted if value not in values]:
        raise ConfigError(
            f"{name}={unknown[0]}: no run has that{suggestion(unknown[0], values.values())}"
        )
    return [
        cell
        for cell in selected
        if key in cell.config and _normalise(setting(cell.config[key])) in wanted
    ]


def _normalise(text: str) -> str:
    """Return a value without spaces, and a number as Python writes it: `2e-3` is 0.002."""
    bare = text.replace(" ", "")
    try:
        return repr(float(bare))
    except ValueError:
        return bare


def _split_values(text: str) -> list[str]:
    """Split values at commas, except inside brackets; brackets around all of them, and quotes, are
    removed.
    """
    inner = text[1:-1] if text.startswith("[") and text.endswith("]") else text
    return [value.strip(" '\"") for value in re.split(r",(?![^\[]*\])", inner)]


def _read_config(row: pd.Series) -> dict[str, Setting]:
    """Return the config of a run. Frames do not distinguish a null from a missing key."""
    return {str(key).removeprefix(CONFIG): _to_plain(value) for key, value in row.dropna().items()}


def _to_plain(value: Any) -> Setting:
    plain = value.item() if isinstance(value, np.generic) else value
    return (
        str(plain) if isinstance(plain, float) and math.isinf(plain) else plain
    )  # JSON has no infinity

"""Group runs into labelled cells, and select some of them by label, pattern or config."""

import ast
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product

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
    """The runs of one cell.

    Attributes:
        label: what distinguishes it from the others of the report.
        settings: value of each factor.
        runs: rows of `Results.runs` by seed, with `is_done`. Of runs with equal seeds it has the
            one that is done, or else is newer.
    """

    experiment: str
    name: str
    label: str
    settings: dict[str, Setting]
    config: Config
    runs: pd.DataFrame

    @property
    def key(self) -> tuple[str, str]:
        """What identifies it, whatever its label."""
        return self.experiment, self.name

    @property
    def task(self) -> str:
        """Name of its task; configs of early exports have parking alone."""
        return str(self.config.get("env.task", "parking"))

    @property
    def done(self) -> pd.DataFrame:
        """The finished runs."""
        return self.runs[self.runs["is_done"]]


def group_runs(runs: pd.DataFrame) -> list[CellRuns]:
    """Return the cells of some runs, in the order of their factors' levels.

    Levels that are numbers are in the order of these, others in the order in which they were begun.
    """
    begun = runs.sort_values("started", kind="stable")
    begun["is_done"] = begun["status"] == "done"
    cells = [_make_cell(rows) for _, rows in begun.groupby(["experiment", "cell"], sort=False)]
    labelled, factors = relabel(cells)
    levels = {factor.key: [*factor.levels, None] for factor in factors}  # a control comes last
    labelled.sort(key=lambda cell: [levels[key].index(cell.settings[key]) for key in levels])
    return labelled


def _make_cell(rows: pd.DataFrame) -> CellRuns:
    """Return the cell of some runs in the order in which they were begun."""
    config_columns = [column for column in rows if str(column).startswith(CONFIG)]
    configs = rows[config_columns].dropna(how="all")  # a damaged file gives no config
    newest = rows.drop(columns=config_columns).sort_values(["seed", "is_done"], kind="stable")
    return CellRuns(
        experiment=str(rows["experiment"].iloc[0]),
        name=str(rows["cell"].iloc[0]),
        label="",
        settings={},
        config=_read_config(configs),
        runs=newest.drop_duplicates("seed", keep="last"),
    )


def _read_config(configs: pd.DataFrame) -> dict[str, Setting]:
    """Return the first config. Frames do not distinguish a null from a missing key."""
    config = {}
    for row in configs.head(1).to_dict("records"):
        for column, value in row.items():
            if pd.notna(value):
                is_infinite = value in (math.inf, -math.inf)  # JSON has no such number
                config[str(column).removeprefix(CONFIG)] = str(value) if is_infinite else value
    return config


def relabel(cells: Sequence[CellRuns]) -> tuple[list[CellRuns], list[Factor]]:
    """Return cells with labels that distinguish these alone, and the factors."""
    configs = [cell.config for cell in cells]
    names = [cell.name for cell in cells]
    factors, settings = find_factors(configs, [cell.experiment for cell in cells])
    if len(cells) > 1:
        labels = labels_from_factors(factors, settings, names)
    else:
        labels = [cell.label for cell in cells if cell.label] or label_cells(configs, names)
    relabelled = [
        replace(cell, label=label, settings=levels)
        for cell, label, levels in zip(cells, labels, settings, strict=True)
    ]
    return relabelled, factors


def choose_cells(
    cells: Sequence[CellRuns], wanted: Sequence[str], key: str = "cells"
) -> list[CellRuns]:
    """Return the cells that fit any of the labels, names and patterns, and all `KEY=VALUE,VALUE`.

    A pattern is e.g. `her_*`. KEY is a group, a config key or the end of one; the values are those
    it may have.
    """
    names = [text for text in wanted if "=" not in text or _find_named(cells, text)]
    conditions = [text for text in wanted if text not in names]
    selected = list(cells)
    if names:
        fitting = [cell for name in names for cell in _find_matching(cells, name, key)]
        selected = [cell for cell in cells if cell in fitting]
    for condition in conditions:
        fitting = _find_configured(cells, condition)
        selected = [cell for cell in selected if cell in fitting]
    if not selected:
        raise ConfigError(f"{key}: no cell fits all of {', '.join(wanted)}")
    return selected


def find_cell(
    cells: Sequence[CellRuns], name: str, key: str, preferred: Sequence[CellRuns] = ()
) -> CellRuns:
    """Return the one cell that fits a label, a name or a pattern; of several, the preferred one.

    Raises:
        ConfigError: none fits, or several; it begins with `key`.
    """
    fitting = choose_cells(cells, [name], key)
    if len(fitting) > 1:
        fitting = [cell for cell in fitting if cell in preferred] or fitting
    if len(fitting) > 1:
        few = ", ".join(repr(cell.label) for cell in fitting[:5])
        raise ConfigError(f"{key}={name}: {len(fitting)} cells fit, e.g. {few}; name one")
    return fitting[0]


def _find_named(cells: Sequence[CellRuns], name: str) -> list[CellRuns]:
    return [cell for cell in cells if name in (cell.label, cell.name)]


def _find_matching(cells: Sequence[CellRuns], pattern: str, key: str) -> list[CellRuns]:
    """Return the cells with a label or a name, else those that a pattern or a part fits."""
    fitting = _find_named(cells, pattern)
    if not fitting:
        for cell in cells:
            words = [cell.label, cell.name, *cell.label.split(", ")]
            if any(fnmatchcase(word, pattern) for word in words):
                fitting.append(cell)
    if not fitting:
        hint = suggestion(pattern, [cell.label for cell in cells])
        raise ConfigError(f"{key}: no cell is called {pattern!r}{hint}")
    return fitting


def _find_configured(cells: Sequence[CellRuns], condition: str) -> list[CellRuns]:
    """Return the cells whose config fits `KEY=VALUE,VALUE`."""
    name, _, text = condition.partition("=")
    key = _find_key(cells, name)
    texts = {cell: setting(cell.config[key]) for cell in cells if key in cell.config}
    values = {cell: _normalise(value) for cell, value in texts.items()}

    wanted = [_normalise(without_quotes(text))]
    if wanted[0] not in values.values():
        wanted = [_normalise(value) for value in _split_values(text)]
    for value in wanted:
        if value not in values.values():
            raise ConfigError(f"{name}={value}: no run has that{suggestion(value, texts.values())}")
    return [cell for cell, value in values.items() if value in wanted]


def _find_key(cells: Sequence[CellRuns], name: str) -> str:
    """Return the config key that a group, a key or the end of one stands for."""
    keys = {key for key in set().union(*(cell.config for cell in cells)) if can_matter(key)}
    keys.add(LABEL)
    exact = f"{name}.name" if name in GROUPS else name
    endings = [key for key in keys if key.endswith(f".{name}")]
    if exact in keys:
        return exact
    if len(endings) == 1:
        return endings[0]
    hint = suggestion(name, {*GROUPS, *report_request.KEYS, *keys})
    raise ConfigError(f"{name}: neither a key of this command nor of these runs' configs{hint}")


def _normalise(text: str) -> str:
    """Return a value without spaces, and a number as Python writes it: `2e-3` is 0.002."""
    bare = text.replace(" ", "")
    try:
        return repr(float(bare))
    except ValueError:
        return bare


def _split_values(text: str) -> list[str]:
    """Split at commas outside brackets; brackets around all values, and quotes, are removed."""
    inner = text[1:-1] if text.startswith("[") and text.endswith("]") else text
    return [value.strip(" '\"") for value in re.split(r",(?![^\[]*\])", inner)]


def find_contrasts(
    cells: Sequence[CellRuns],
) -> tuple[list[tuple[CellRuns, CellRuns]], list[str], list[str]]:
    """Return the pairs that experiments declare as `contrasts`, and what is wrong with others.

    That are the pairs that name no cell, and warnings. Those of an experiment's first run count,
    and its cells are named as in a report on it alone.
    """
    contrasts: dict[frozenset[tuple[str, str]], tuple[CellRuns, CellRuns]] = {}
    unknown = []
    warnings = []
    for experiment in dict.fromkeys(cell.experiment for cell in cells):
        own, _ = relabel([cell for cell in cells if cell.experiment == experiment])
        try:
            declared = _read_contrasts(own)
        except (ValueError, SyntaxError, MemoryError, RecursionError):  # of a foreign store, or cut
            warnings.append(f"{experiment}: its contrasts can't be read.")
            continue
        for pair in declared:
            try:
                first, second = (find_cell(own, name, "contrasts") for name in pair)
            except ConfigError:
                unknown.append(" minus ".join(pair))
                continue
            if first is not second:
                contrasts.setdefault(frozenset([first.key, second.key]), (first, second))
    return list(contrasts.values()), unknown, warnings


def _read_contrasts(cells: Sequence[CellRuns]) -> list[tuple[str, str]]:
    first = min(cells, key=lambda cell: cell.runs["started"].min())
    text = str(first.config.get("contrasts"))
    return CONTRASTS.validate_python(ast.literal_eval(text)) or []


def match_cells(
    cells: Sequence[CellRuns], factors: Sequence[Factor], contrast: str
) -> list[tuple[CellRuns, CellRuns]]:
    """Return the pairs of cells that differ in one factor alone, for `FACTOR:LEVEL-LEVEL`.

    A factor that one of the two cells does not have is not compared, such as `n_sampled_goal` of
    replay.

    Raises:
        ConfigError: there is no such factor or level, or no two cells match.
    """
    name, _, levels = contrast.partition(":")
    named = [factor for factor in factors if name in (factor.key, factor.name)]
    if not named:
        hint = suggestion(name, [factor.name for factor in factors])
        raise ConfigError(f"contrast={contrast}: these cells do not differ in {name!r}{hint}")
    factor = named[0]
    first_level, second_level = _find_levels(factor, levels, contrast)
    first_cells = [cell for cell in cells if _level(cell, factor) == first_level]
    second_cells = [cell for cell in cells if _level(cell, factor) == second_level]
    others = [other for other in factors if other is not factor]
    pairs = [
        (first, second)
        for first, second in product(first_cells, second_cells)
        if first is not second and _are_matched(first, second, others)
    ]
    if not pairs:
        raise ConfigError(
            f"contrast={contrast}: no two of these cells differ in {factor.name} alone"
        )
    return pairs


def _find_levels(factor: Factor, text: str, contrast: str) -> tuple[str, str]:
    """Return the two levels of `LEVEL-LEVEL`, which may have hyphens themselves."""
    known = {_normalise(setting(level)) for level in factor.levels}
    splits = [
        (_normalise(text[: hyphen.start()]), _normalise(text[hyphen.end() :]))
        for hyphen in re.finditer("-", text)
    ]
    best = max(splits, key=lambda levels: len(known.intersection(levels)))
    for level in best:
        if level not in known:
            hint = suggestion(level, map(setting, factor.levels))
            raise ConfigError(f"contrast={contrast}: {factor.name} has no level {level!r}{hint}")
    return best


def _level(cell: CellRuns, factor: Factor) -> str:
    return _normalise(setting(cell.settings[factor.key]))


def _are_matched(first: CellRuns, second: CellRuns, factors: Sequence[Factor]) -> bool:
    """Return whether two cells are equal in the factors that both have."""
    for factor in factors:
        levels = (first.settings[factor.key], second.settings[factor.key])
        if None not in levels and _level(first, factor) != _level(second, factor):
            return False
    return True

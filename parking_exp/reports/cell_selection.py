"""Group runs into labelled cells, and select some of them by label, pattern or config."""

import ast
import fnmatch
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import pandas as pd
from pydantic import TypeAdapter

from parking_exp.config.cell_labels import (
    LABEL,
    Factor,
    find_factors,
    label_cells,
    labels_from_factors,
)
from parking_exp.config.overrides import without_quotes
from parking_exp.config.settings import (
    FlatConfig,
    Setting,
    display_setting,
    distinguishes_cells,
    hashable,
)
from parking_exp.errors import ConfigError
from parking_exp.phrases import suggestion
from parking_exp.results.frames import CONFIG_PREFIX, config_columns

CONTRASTS = TypeAdapter(list[tuple[str, str]] | None)


@dataclass(frozen=True, eq=False)
class CellRuns:
    """The runs of one cell.

    Attributes:
        experiment: the name of its experiment.
        name: folder of its runs.
        config: its config by dotted keys, without null values.
        id: `c0`, `c1`, ... in the order of the report.
        label: what distinguishes it from the others of the report.
        settings: value of each factor.
        runs: rows of `Results.runs` by seed, with `is_done`. If several runs have the same seed,
            it has the finished one, or else the newest.
    """

    experiment: str
    name: str
    config: FlatConfig
    runs: pd.DataFrame
    id: str = ""
    label: str = ""
    settings: Mapping[str, Setting] = field(default_factory=dict)

    @property
    def identity(self) -> tuple[str, str]:
        """Its experiment and name, which identify it whatever its label is."""
        return self.experiment, self.name

    @property
    def task(self) -> str:
        """The name of its task; configs of early exports have parking alone."""
        return str(self.config.get("env.task", "parking"))

    @property
    def done(self) -> pd.DataFrame:
        """The finished runs."""
        return self.runs[self.runs["is_done"]]


def group_runs(runs: pd.DataFrame) -> list[CellRuns]:
    """Return the cells of some runs, in the order of their factors' levels.

    Numeric levels are sorted. Other levels are in the order in which their first runs started.
    """
    begun = runs.sort_values("started", kind="stable")
    begun["is_done"] = begun["status"] == "done"
    cells = [_make_cell(rows) for _, rows in begun.groupby(["experiment", "cell"], sort=False)]
    labelled, factors = relabel(cells)
    # A control, which lacks a key, comes last.
    levels = {factor.key: [*factor.levels, None] for factor in factors}
    labelled.sort(key=lambda cell: [levels[key].index(cell.settings[key]) for key in levels])
    return labelled


def _make_cell(rows: pd.DataFrame) -> CellRuns:
    """Return the cell of some runs in the order in which they were begun."""
    configs = rows[config_columns(rows)]
    newest = rows.sort_values(["seed", "is_done"], kind="stable")
    return CellRuns(
        experiment=str(rows["experiment"].iloc[0]),
        name=str(rows["cell"].iloc[0]),
        config=_read_config(configs.dropna(how="all")),
        runs=newest.drop_duplicates("seed", keep="last"),
    )


def _read_config(configs: pd.DataFrame) -> dict[str, Setting]:
    """Return the config of the first run that has one; runs with a damaged file have none.

    Null values are left out: in a frame, they look like missing keys.
    """
    if configs.empty:
        return {}
    (first,) = configs.head(1).to_dict("records")
    config = {}
    for column, value in first.items():
        if pd.notna(value):
            # JSON has no infinite numbers.
            is_infinite = value in (math.inf, -math.inf)
            config[str(column).removeprefix(CONFIG_PREFIX)] = str(value) if is_infinite else value
    return config


def relabel(cells: Sequence[CellRuns]) -> tuple[list[CellRuns], list[Factor]]:
    """Give cells ids, and labels by what distinguishes them; return them and the factors."""
    configs = [cell.config for cell in cells]
    names = [cell.name for cell in cells]
    factors, settings = find_factors(configs, [cell.experiment for cell in cells])
    if len(cells) > 1:
        labels = labels_from_factors(factors, settings, names)
    elif cells[0].label:  # a selected cell keeps the label that it has among all cells
        labels = [cells[0].label]
    else:
        labels = label_cells(configs, names)
    relabelled = []
    for number, cell in enumerate(cells):
        copy = replace(cell, id=f"c{number}", label=labels[number], settings=settings[number])
        relabelled.append(copy)
    return relabelled, factors


def choose_cells(
    cells: Sequence[CellRuns], wanted: Sequence[str], key: str = "cells"
) -> list[CellRuns]:
    """Return the cells that fit any label, name or pattern, and all conditions.

    A pattern is e.g. `her_*`. A condition `KEY=VALUE,VALUE` lists the values that KEY may have.
    KEY is a group, a config key or the end of a config key.
    """
    labels = {cell.label for cell in cells} | {cell.name for cell in cells}
    words = {cell: _list_words(cell) for cell in cells}
    named = []
    selected = list(cells)
    for text in wanted:
        if "=" not in text or text in labels:
            named += _find_matching(words, text, key)
            continue
        fitting = []
        for alternative in _split_condition(text, words):
            fitting += _find_matching(words, alternative, key)
        selected = [cell for cell in selected if cell in fitting]
    if named:
        selected = [cell for cell in selected if cell in named]
    if not selected:
        raise ConfigError(f"{key}: no cell fits all of {', '.join(wanted)}")
    return selected


Words = dict[CellRuns, set[str]]
"""What each cell may be selected by."""


def _list_words(cell: CellRuns) -> set[str]:
    """Return the label of a cell, its parts, and `KEY=VALUE` for each end of its config's keys."""
    words = {cell.label, cell.name, *cell.label.split(", ")}
    for key, value in {**cell.config, **cell.settings}.items():
        if distinguishes_cells(key) or key == LABEL:
            text = _normalise(display_setting(value))
            words.add(f"{key.removesuffix('.name')}={text}")
            ending = key
            while ending:
                words.add(f"{ending}={text}")
                ending = ending.partition(".")[2]
    return words


def _split_condition(text: str, words: Words) -> list[str]:
    """Return `KEY=VALUE` of each value of a condition; commas may be part of a value."""
    key, _, values = text.partition("=")
    single = f"{key}={_normalise(without_quotes(values))}"
    if any(single in texts for texts in words.values()):
        return [single]
    return [f"{key}={_normalise(value)}" for value in _split_values(values)]


def _find_matching(words: Words, pattern: str, key: str) -> list[CellRuns]:
    """Return the cells that have a label, a name or a word, else those that a pattern fits."""
    fitting = [cell for cell in words if pattern in (cell.label, cell.name)]
    if not fitting:
        fitting = [cell for cell, texts in words.items() if pattern in texts]
    if not fitting:
        fitting = [cell for cell, texts in words.items() if fnmatch.filter(texts, pattern)]
    if fitting:
        return fitting
    if "=" in pattern:
        verb = "has"
        known = set().union(*words.values())
    else:
        verb = "is called"
        known = {cell.label for cell in words}
    raise ConfigError(f"{key}: no cell {verb} {pattern!r}{suggestion(pattern, known)}")


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


def _normalise(text: str) -> str:
    """Return a value without spaces, and a number as settings are written: `2e-3` is 0.002."""
    bare = text.replace(" ", "")
    try:
        return display_setting(float(bare))
    except ValueError:
        return bare


def _split_values(text: str) -> list[str]:
    """Split at commas outside brackets; brackets around all values, and quotes, are removed."""
    inner = text[1:-1] if text.startswith("[") and text.endswith("]") else text
    return [value.strip(" '\"") for value in re.split(r",(?![^\[]*\])", inner)]


def find_contrasts(
    cells: Sequence[CellRuns],
) -> tuple[list[tuple[CellRuns, CellRuns]], list[str], list[str]]:
    """Return the pairs of cells that experiments declare as `contrasts`.

    The first run of an experiment declares them. They name its cells as in a report on this
    experiment alone.

    Returns:
        The pairs; the contrasts that name no cell, as `A minus B`; and warnings, a sentence for
        each experiment whose contrasts can't be read.
    """
    contrasts: dict[frozenset[tuple[str, str]], tuple[CellRuns, CellRuns]] = {}
    unknown = []
    warnings = []
    for experiment in dict.fromkeys(cell.experiment for cell in cells):
        labelled, _ = relabel([cell for cell in cells if cell.experiment == experiment])
        try:
            declared = _read_contrasts(labelled)
        # In a foreign store they may be anything, and long ones are cut.
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            warnings.append(f"{experiment}: its contrasts can't be read.")
            continue
        for names in declared:
            try:
                first, second = [find_cell(labelled, name, "contrasts") for name in names]
            except ConfigError:
                unknown.append(" minus ".join(names))
                continue
            if first is not second:
                contrasts.setdefault(frozenset([first.identity, second.identity]), (first, second))
    return list(contrasts.values()), unknown, warnings


def _read_contrasts(cells: Sequence[CellRuns]) -> list[tuple[str, str]]:
    first = min(cells, key=lambda cell: cell.runs["started"].min())
    text = str(first.config.get("contrasts"))
    return CONTRASTS.validate_python(ast.literal_eval(text)) or []


def match_cells(
    cells: Sequence[CellRuns], factors: Sequence[Factor], contrast: str
) -> list[tuple[CellRuns, CellRuns]]:
    """Return the pairs of cells that differ in one factor alone, for `FACTOR:LEVEL-LEVEL`.

    Factors that one of the two cells lacks are ignored, such as `n_sampled_goal` of replay.

    Raises:
        ConfigError: there is no such key or level, or no two cells match.
    """
    name, _, levels = contrast.partition(":")
    first_cells, second_cells = _find_sides(cells, name, levels, f"contrast={contrast}")
    others = [factor for factor in factors if name not in (factor.key, factor.name)]
    pairs = [
        (first, second)
        for first, second in product(first_cells, second_cells)
        if first is not second and _are_matched(first, second, others)
    ]
    if not pairs:
        raise ConfigError(f"contrast={contrast}: no two of these cells differ in {name} alone")
    return pairs


def _find_sides(
    cells: Sequence[CellRuns], name: str, levels: str, key: str
) -> tuple[list[CellRuns], list[CellRuns]]:
    """Return the cells with each level of `LEVEL-LEVEL`; a level may have hyphens itself."""
    problems = []
    for hyphen in re.finditer("-", levels):
        first = f"{name}={levels[: hyphen.start()]}"
        second = f"{name}={levels[hyphen.end() :]}"
        try:
            return choose_cells(cells, [first], key), choose_cells(cells, [second], key)
        except ConfigError as error:
            problems.append(error)
    raise problems[0]


def _are_matched(first: CellRuns, second: CellRuns, factors: Sequence[Factor]) -> bool:
    """Return whether two cells are equal in the factors that both have."""
    for factor in factors:
        levels = {hashable(first.settings[factor.key]), hashable(second.settings[factor.key])}
        if len(levels - {hashable(None)}) > 1:
            return False
    return True

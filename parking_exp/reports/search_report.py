"""The hyperparameter search of a report: read from its folder, in sentences and tables.

Optuna is imported only if an experiment has a search.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from parking_exp.config.settings import display_setting
from parking_exp.config_model import NAME
from parking_exp.errors import ParkingError, first_line
from parking_exp.phrases import plural
from parking_exp.report_section import Column, Table
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.tables.table import (
    interval_column,
    row_of,
    spread,
    text_column,
)
from parking_exp.statistics import Interval, SeedRates, compare, mean_interval
from parking_exp.tuning.search import StoredSearch, read_search
from parking_exp.tuning.trials import OBJECTIVE, RetestedTrial, describe_states, rank_trials


def with_stored_search(report: ReportData, output_dir: Path) -> ReportData:
    """Return a report with the first search of its experiments; damaged ones are warnings."""
    names = [name for name in report.experiments if re.fullmatch(NAME, name)]
    for folder in [output_dir / name for name in names]:
        try:
            search = read_search(folder)
        except ParkingError as error:
            warning = f"The search of {folder.name} is left out: {first_line(error).rstrip('.')}."
            report = replace(report, warnings=[*report.warnings, warning])
            continue
        if search is not None:
            return with_search(report, search)
    return report


def with_search(report: ReportData, search: StoredSearch) -> ReportData:
    """Return a report with a search, what it found, and a warning about comparing its cells."""
    claims = [*report.claims]
    remedy = "none was retrained on test seeds"
    if search.retested:
        best = search.retested[0]
        remedy = "compare the trials retrained on test seeds"
        claims.insert(
            0,
            f"On {plural(len(best.test), 'test seed')}, “{best.label}” is the best of "
            f"{plural(len(search.retested), 'retrained trial')}: {OBJECTIVE} "
            f"{formats.percent_interval_in_words(mean_interval(best.test))}; "
            f"tuning minus test {formats.points_interval_in_words(_compare_seeds(best))}.",
        )
    warning = (
        "Cells of a search include runs on the tuning seeds that trials were selected by; "
        f"{remedy}."
    )
    return replace(report, tuning=search, claims=claims, warnings=[*report.warnings, warning])


def _compare_seeds(trial: RetestedTrial) -> Interval:
    """Return the mean on tuning seeds minus that on test seeds."""
    return compare([([SeedRates(trial.tuning)], [SeedRates(trial.test)])])[0]


def describe_search(report: ReportData) -> Iterator[str]:
    """Yield the paragraph about a search: its trials, and the best of them."""
    search = report.tuning
    if search is None:
        return
    settings = search.settings
    text = (
        f"{plural(search.n_trials, 'trial')} (sampler {settings.sampler}, pruner "
        f"{settings.pruner or 'none'}): {describe_states(search.trials, search.n_trials)}. "
        f"Objective: {OBJECTIVE}, mean over {plural(len(settings.tuning_seeds), 'tuning seed')}."
    )
    ranked = rank_trials(search.trials)
    if ranked:
        best = ranked[0]
        text += f" The best is “{best.label}” with {formats.percent_in_words(best.value)}."
    yield text


def trial_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of a search's trials."""
    search = report.tuning
    if search is None:
        return
    settings = search.settings
    columns = [
        Column("Trial", "number", formats.number, numeric=False),
        text_column("State", "state"),
        Column(OBJECTIVE, OBJECTIVE, formats.percent),
    ]
    for name, dimension in settings.space.items():
        is_number = dimension.choices is None
        columns.append(Column(name, name, _write_parameter, numeric=is_number))
    if any(trial.reason for trial in search.trials):
        columns.append(text_column("Why it failed", "reason"))

    rows = []
    for trial in search.trials:
        row: dict[str, Any] = {OBJECTIVE: trial.value}
        row |= dict.fromkeys(settings.space)
        row |= trial.parameters
        row |= row_of(trial)
        row["label"] = trial.label
        rows.append(row)
    caption = f"Trials: means over {len(settings.tuning_seeds)} tuning seeds (%), and parameters."
    yield Table("trials", rows, columns, caption, latex=True)


def _write_parameter(value: Any) -> str:
    """Write a parameter, which trial 0 may lack."""
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else display_setting(value)


def retest_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of the trials that were trained again on test seeds."""
    search = report.tuning
    if search is None or not search.retested:
        return
    rows = []
    for trial in search.retested:
        row: dict[str, Any] = {"number": trial.number, "label": trial.label}
        row |= {"n_tuning": len(trial.tuning), "n_test": len(trial.test)}
        row |= spread("tuning", mean_interval(trial.tuning))
        row |= spread("test", mean_interval(trial.test))
        rows.append(row | spread("difference", _compare_seeds(trial)))
    columns = [
        text_column("Trial", "label"),
        interval_column("Tuning seeds", "tuning"),
        interval_column("Test seeds", "test"),
        interval_column("Tuning minus test (points)", "difference", formats.points_interval),
    ]
    caption = (
        "The best trials and trial 0, the unchanged config, trained again on seeds that no trial "
        f"was selected by: {OBJECTIVE} (%), with 95 % intervals. Values on tuning seeds are "
        "optimistic for the best of many."
    )
    yield Table("retest", rows, columns, caption, latex=True)

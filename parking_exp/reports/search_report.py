"""The hyperparameter search of a report: read from its experiment's folder, in sentences and
tables.

Optuna is imported only if an experiment has a search.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from parking_exp.config_model import NAME
from parking_exp.errors import ParkingError, ResultsError, first_line, plural
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.tables.table import Table, column, interval_column, record, spread
from parking_exp.statistics import Interval, SeedRates, compare, mean_interval
from parking_exp.tuning.search import SEARCH_FILE, study_in
from parking_exp.tuning.trials import (
    OBJECTIVE,
    RETEST_FILE,
    RetestedTrial,
    TrialRow,
    count_states,
    plain_choice,
    rank_trials,
    read_retest,
)

if TYPE_CHECKING:
    from parking_exp.tuning.search import StoredSearch


@dataclass(frozen=True)
class Tuning:
    """The hyperparameter search of an experiment.

    Attributes:
        n_trials: number of trials requested.
        objective: its name; it is maximised.
        n_seeds: number of tuning seeds of each trial.
        parameters: name -> Optuna's distribution, as `optuna.distributions.distribution_to_json`
            describes it.
        trials: trial 0 and those that have begun, by number.
        retested: trials that were trained again on test seeds, best first.
    """

    experiment: str
    sampler: str
    pruner: str | None
    n_trials: int
    objective: str
    n_seeds: int
    parameters: Mapping[str, Mapping[str, Any]]
    trials: Sequence[TrialRow]
    retested: Sequence[RetestedTrial] = ()


def add_search(report: ReportData, output_dir: Path) -> ReportData:
    """Return a report with the first search of its experiments, or a warning where that cannot be
    read.
    """
    folders = [output_dir / name for name in report.experiments if re.fullmatch(NAME, name)]
    folder = next((folder for folder in folders if (folder / SEARCH_FILE).exists()), None)
    if folder is None:
        return report
    try:
        stored = study_in(folder)
        return add_tuning(report, read_tuning(folder, stored)) if stored else report
    except ParkingError as error:
        warning = f"The search of {folder.name} is left out: {first_line(error).rstrip('.')}."
        return replace(report, warnings=[*report.warnings, warning])


def add_tuning(report: ReportData, tuning: Tuning) -> ReportData:
    """Return a report with a search, a claim on its retrained trials, and a warning about comparing
    its cells.
    """
    claims, remedy = [*report.claims], "none was retrained on test seeds"
    if tuning.retested:
        best, remedy = tuning.retested[0], "compare the trials retrained on test seeds"
        claims.insert(
            0,
            f"On {plural(len(best.test), 'test seed')}, “{best.label}” is the best of "
            f"{plural(len(tuning.retested), 'retrained trial')}: {tuning.objective} "
            f"{formats.rate_interval(mean_interval(best.test))}; "
            f"tuning minus test {formats.points_interval(_compare_seeds(best))}.",
        )
    warning = (
        "Cells of a search include runs on the tuning seeds that trials were selected by; "
        f"{remedy}."
    )
    return replace(report, tuning=tuning, claims=claims, warnings=[*report.warnings, warning])


def read_tuning(folder: Path, stored: "StoredSearch") -> Tuning:
    """Return the search in an experiment's folder; ResultsError if its retrained trials are
    damaged.
    """
    try:
        retested = read_retest(folder)
    except ValidationError as error:
        raise ResultsError(f"{folder.name}/{RETEST_FILE} can't be read") from error
    search = stored.search
    distributions: dict[str, Any] = {}
    for trial in stored.study.get_trials(deepcopy=False):
        distributions |= trial.distributions
    return Tuning(
        experiment=folder.name,
        sampler=search.sampler,
        pruner=search.pruner,
        n_trials=stored.n_trials,
        objective=OBJECTIVE,
        n_seeds=len(search.tuning_seeds),
        parameters={
            name: _describe_distribution(distribution)
            for name, distribution in distributions.items()
        },
        trials=stored.trials,
        retested=retested,
    )


def _describe_distribution(distribution: Any) -> Mapping[str, Any]:
    from optuna.distributions import distribution_to_json

    description: dict[str, Any] = json.loads(distribution_to_json(distribution))
    if choices := description["attributes"].get("choices"):
        description["attributes"]["choices"] = list(dict.fromkeys(map(plain_choice, choices)))
    return description


def _compare_seeds(trial: RetestedTrial) -> Interval:
    """Return the mean on tuning seeds minus that on test seeds."""
    return compare([([SeedRates(trial.tuning)], [SeedRates(trial.test)])])[0]


def describe_search(report: ReportData) -> Iterator[str]:
    """Yield the paragraph about a search: its trials, and the best of them."""
    tuning = report.tuning
    if tuning is None:
        return
    by_state = count_states(tuning.trials)
    by_state["pending"] += tuning.n_trials - len(tuning.trials)
    states = ", ".join(f"{number} {state}" for state, number in by_state.items() if number)
    text = (
        f"{plural(tuning.n_trials, 'trial')} (sampler {tuning.sampler}, pruner "
        f"{tuning.pruner or 'none'}): {states}. "
        f"Objective: {tuning.objective}, mean over {plural(tuning.n_seeds, 'tuning seed')}."
    )
    for best in rank_trials(tuning.trials)[:1]:
        text += f" The best is “{best.label}” with {formats.rate_text(best.value)}."
    yield text


def trial_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of a search's trials."""
    tuning = report.tuning
    if tuning is None:
        return
    parameters = dict.fromkeys(tuning.parameters)
    rows = [
        {
            tuning.objective: trial.value,
            **parameters,
            **trial.parameters,
            **record(trial),
            "label": trial.label,
        }
        for trial in tuning.trials
    ]
    is_number = {
        name: kind.get("name") != "CategoricalDistribution"
        for name, kind in tuning.parameters.items()
    }
    yield Table(
        "trials",
        rows,
        [
            column("Trial", "number", formats.number, numeric=False),
            column("State", "state", numeric=False),
            column(tuning.objective, tuning.objective, formats.percent),
            *(
                column(name, name, _write_parameter, numeric=is_number[name])
                for name in tuning.parameters
            ),
            *(
                [column("Why it failed", "reason", numeric=False)]
                if any(row["reason"] for row in rows)
                else []
            ),
        ],
        f"Trials: means over {tuning.n_seeds} tuning seeds (%), and parameters.",
        latex=True,
    )


def _write_parameter(value: Any) -> str:
    """Write a parameter, which trial 0 may lack."""
    return (
        ""
        if value is None
        else f"{value:.3g}"
        if isinstance(value, float)
        else formats.setting(value)
    )


def retest_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of the trials that were trained again on test seeds."""
    tuning = report.tuning
    if tuning is None or not tuning.retested:
        return
    rows = [
        {
            "number": trial.number,
            "label": trial.label,
            "n_tuning": len(trial.tuning),
            "n_test": len(trial.test),
            **spread("tuning", mean_interval(trial.tuning)),
            **spread("test", mean_interval(trial.test)),
            **spread("difference", _compare_seeds(trial)),
        }
        for trial in tuning.retested
    ]
    yield Table(
        "retest",
        rows,
        [
            column("Trial", "label", numeric=False),
            interval_column("Tuning seeds", "tuning"),
            interval_column("Test seeds", "test"),
            interval_column("Tuning minus test", "difference", formats.points_interval),
        ],
        "The best trials and trial 0, the unchanged config, trained again on seeds that no trial "
        "was selected by: "
        f"{tuning.objective} (%), with 95 % intervals. Values on tuning seeds are optimistic for "
        "the best of many.",
        latex=True,
    )

"""Read the hyperparameter search of an experiment for its report.

Nothing here imports Optuna unless an experiment has a search.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from parking_exp.config.schema import NAME
from parking_exp.errors import ParkingError
from parking_exp.reports import formats
from parking_exp.reports.report_data import Interval, ReportData
from parking_exp.reports.tuning_data import Retested, Tuning
from parking_exp.reports.tuning_findings import claims
from parking_exp.statistics import mean_interval, welch
from parking_exp.tuning.retest import RetestedTrial, read_retest
from parking_exp.tuning.search import SEARCH_FILE, study_in
from parking_exp.tuning.search_config import SearchConfig
from parking_exp.tuning.study import storage_errors
from parking_exp.tuning.trials import TrialRow, plain_choice

if TYPE_CHECKING:
    from optuna import Study


def with_search(report: ReportData, output_dir: Path, storage: str | None = None) -> ReportData:
    """Return a report with the first readable search of its experiments, and a warning for each unreadable one."""
    named = [name for name in report.experiments if re.fullmatch(NAME, name)]
    searches = [name for name in named if (output_dir / name / SEARCH_FILE).exists()]
    warnings = list(report.warnings)
    for place, name in enumerate(searches):
        try:
            if (stored := study_in(output_dir / name, storage)) is None:
                continue
            tuning = tuning_of(output_dir / name, stored.search, stored.n_trials, stored.trials, stored.study)
        except ParkingError as error:
            warnings.append(f"The search of {name} is left out: {str(error).splitlines()[0].rstrip('.')}.")
            continue
        others = ", ".join(searches[place + 1 :])
        notes = [f"The report shows the search of {name}, and not those of {others}."] if others else []
        return with_tuning(replace(report, warnings=warnings, notes=[*report.notes, *notes]), tuning)
    return replace(report, warnings=warnings)


def with_tuning(report: ReportData, tuning: Tuning) -> ReportData:
    """Return a report with a search, its main finding, and a warning about comparing its cells."""
    fair = "compare the trials retrained on fresh seeds" if tuning.retested else "none was retrained on fresh seeds"
    warning = f"Cells of a search include runs on the tuning seeds that trials were selected by; {fair}."
    return replace(
        report,
        tuning=tuning,
        claims=[*claims(tuning), *report.claims],
        warnings=[*report.warnings, warning],
    )


def tuning_of(folder: Path, search: SearchConfig, n_trials: int, trials: Sequence[TrialRow], study: "Study") -> Tuning:
    """Return a search as reports show it.

    Args:
        folder: of the experiment.
        search: its settings.
        n_trials: number of trials requested.
        trials: the trials so far.
        study: Optuna's study, which knows the distributions of parameters.
    """
    notes = []
    try:
        retested = [_retested(trial) for trial in read_retest(folder)]
    except ValidationError:
        retested = []
        notes.append(f"The retest is left out: {folder.name}/retest.json can't be read.")
    with storage_errors(study.study_name):
        distributions = {
            name: distribution
            for trial in study.get_trials(deepcopy=False)
            for name, distribution in trial.distributions.items()
        }
    return Tuning(
        experiment=folder.name,
        sampler=search.sampler,
        pruner=search.pruner,
        n_trials=n_trials,
        objectives=search.objective,
        n_seeds=len(search.tuning_seeds),
        parameters={name: _described(distribution) for name, distribution in distributions.items()},
        trials=trials,
        retested=retested,
        notes=notes,
    )


def _described(distribution: Any) -> Mapping[str, Any]:
    """Return a distribution as JSON, with readable choices."""
    from optuna.distributions import distribution_to_json

    found: dict[str, Any] = json.loads(distribution_to_json(distribution))
    if choices := found["attributes"].get("choices"):
        found["attributes"]["choices"] = list(dict.fromkeys(map(plain_choice, choices)))
    return found


def _retested(trial: RetestedTrial) -> Retested:
    found = welch(trial.tuning, trial.test)
    low, high = (formats.within(end, -1.0, 1.0) for end in (found.low, found.high))
    return Retested(
        number=trial.number,
        label=trial.label,
        n_tuning=len(trial.tuning),
        n_test=len(trial.test),
        tuning=_mean(trial.tuning),
        test=_mean(trial.test),
        difference=Interval(found.difference, low, high, min(found.n_a, found.n_b), found.method),
    )


def _mean(rates: Sequence[float]) -> Interval:
    found = mean_interval(rates, bounds=(0.0, 1.0))
    return Interval(found.mean, formats.finite(found.low), formats.finite(found.high), found.n, found.method)

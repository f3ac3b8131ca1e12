"""Tables of a search: its trials, and those that were trained again on fresh seeds."""

from collections.abc import Iterator, Sequence

from parking_exp.reports import formats
from parking_exp.reports.report_data import Cell, Interval, ReportData
from parking_exp.reports.tables.model import (
    Column,
    Entry,
    Table,
    column,
    number,
    percent,
    rate,
    setting,
    spread,
    values,
    whole,
    words,
)
from parking_exp.tuning.trials import TrialRow


def trials(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of a search's trials."""
    tuning = report.tuning
    if tuning is None:
        return
    reasons = any(trial.reason for trial in tuning.trials)
    yield Table(
        "trials",
        [
            column("Trial", whole, "number", numeric=False),
            column("State", words, "state", numeric=False),
            *(_value(name, place) for place, name in enumerate(tuning.objectives)),
            *(_parameter(name, f"{kind.get('name')}") for name, kind in tuning.parameters.items()),
            column("Env steps", whole, "env_steps"),
            column("CPU (s)", number, "cpu_s"),
            *([column("Why it failed", _optional, "reason", numeric=False)] if reasons else values("reason")),
            *values("label"),
        ],
        tuning.trials,
        f"Trials: means over {tuning.n_seeds} tuning seeds (%), parameters, and what they took.",
        title="Trials",
        latex=True,
        noun="trials",
    )


def _value(name: str, place: int) -> Column:
    return column(name, percent, name, lambda trial: trial.values[place] if trial.values else None)


def _parameter(name: str, distribution: str) -> Column:
    """Return the column of a parameter, which conditions may have kept out of some trials."""

    def entry(trial: TrialRow) -> Entry:
        if name not in trial.parameters:
            return Entry("")
        value = trial.parameters[name]
        return Entry(f"{value:.3g}", value) if isinstance(value, float) else setting(value)

    numeric = distribution != "CategoricalDistribution"
    return Column(name, entry, {name: lambda trial: trial.parameters.get(name)}, numeric=numeric)


def _optional(text: str | None) -> Entry:
    return Entry(text or "", text)


def retest(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of the trials that were trained again on fresh seeds."""
    tuning = report.tuning
    if tuning is None or not tuning.retested:
        return
    yield Table(
        "retest",
        [
            column("Trial", words, "label", numeric=False),
            spread("Tuning seeds", rate, "tuning"),
            spread("Fresh seeds", rate, "test"),
            spread("Tuning minus test", _points, "difference"),
            *values("number", "n_tuning", "n_test"),
        ],
        tuning.retested,
        f"Retrained trials: {tuning.objectives[0]} (%) on tuning seeds and on fresh ones, with 95 % intervals.",
        title="Retrained on fresh seeds",
        latex=True,
        noun="trials",
    )


def _points(difference: Interval) -> Entry:
    return Entry(formats.points_interval(difference), difference.value)

"""Tables of a search: its trials, and those that were trained again on fresh seeds."""

from collections.abc import Iterator, Sequence

from parking_exp.reports.report_data import Cell, Factor, Interval, ReportData
from parking_exp.reports.tables.model import Column, Entry, Table, bounds, column, number, setting, values, whole, words
from parking_exp.reports.tuning_data import Objective, Retested, Trial, Tuning
from parking_exp.reports.tuning_findings import difference_text, mean_text, value_text


def trials(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of a search's trials."""
    tuning = report.tuning
    if tuning is None:
        return
    yield Table(
        "trials",
        [
            column("Trial", _number, "number", numeric=False),
            column("State", words, "state", numeric=False),
            *(_value(tuning, place) for place in range(len(tuning.objectives))),
            *(_parameter(factor) for factor in tuning.parameters),
            column("Env steps", whole, "env_steps"),
            column("CPU (s)", number, "cpu_s"),
            *_where_known(tuning, "Cost (CPU-s)", "cost"),
            *_where_known(tuning, "Why it failed", "reason"),
            *values("label", "seconds"),
        ],
        tuning.trials,
        f"Trials: means over {len(tuning.tuning_seeds)} tuning seeds, parameters, and what they took.",
        title="Trials",
        latex=True,
        noun="trials",
    )


def _number(value: int) -> Entry:
    return Entry(str(value), value)


def _value(tuning: Tuning, place: int) -> Column:
    objective, n_seeds = tuning.objectives[place], len(tuning.tuning_seeds)

    def get(trial: Trial) -> float | None:
        return trial.values[place] if trial.values else None

    def entry(value: float | None) -> Entry:
        return Entry("") if value is None else Entry(value_text(objective, value, n_seeds), value)

    return column(objective.name, entry, objective.name, get)


def _parameter(factor: Factor) -> Column:
    """Return the column of a parameter, for people with three digits; conditional ones are not in every trial."""

    def read(trial: Trial) -> Entry:
        if factor.key not in trial.settings:
            return Entry("")
        value = trial.settings[factor.key]
        return Entry(f"{value:.3g}", value) if isinstance(value, float) else setting(value)

    get = {factor.key: lambda trial: trial.settings.get(factor.key)}
    return Column(factor.name, read, get, numeric=factor.numeric)


def _where_known(tuning: Tuning, title: str, key: str) -> list[Column]:
    """Return a column for people and CSV where some trial has something to say in it, else one for CSV alone."""
    if all(getattr(trial, key) is None for trial in tuning.trials):
        return values(key)
    if key == "reason":
        return [column(title, lambda text: Entry(text or "", text), key, numeric=False)]
    return [column(title, number, key)]


def retest(report: ReportData, cells: Sequence[Cell]) -> Iterator[Table]:
    """Yield the table of the trials that were trained again on fresh seeds."""
    tuning = report.tuning
    objective = tuning.retested_on if tuning else None
    if tuning is None or objective is None:
        return
    yield Table(
        "retest",
        [
            column("Trial", words, "label", numeric=False),
            *values("number"),
            _mean(objective, "Tuning seeds", "tuning"),
            _mean(objective, "Fresh seeds", "test"),
            Column(
                "Tuning minus test",
                lambda one: _difference(objective, one.difference),
                bounds("difference", lambda one: one.difference),
                numeric=True,
            ),
            Column(csv={"n_tuning": lambda one: len(one.tuning), "n_test": lambda one: len(one.test)}),
            *values("tuning_missed", "test_missed"),
        ],
        tuning.retested,
        f"Trials that were trained again: {objective.name} on tuning seeds, by which they were chosen, and on fresh "
        "ones, with 95 % intervals.",
        title="Trained again on fresh seeds",
        latex=True,
        noun="trials",
    )


def _mean(objective: Objective, title: str, key: str) -> Column:
    def read(one: Retested) -> Entry:
        mean: Interval = getattr(one, f"{key}_mean")
        missed, n = getattr(one, f"{key}_missed"), len(getattr(one, key))
        return Entry(mean_text(objective, mean, missed, n), mean.value)

    return Column(title, read, bounds(key, lambda one: getattr(one, f"{key}_mean")), numeric=True)


def _difference(objective: Objective, difference: Interval) -> Entry:
    return Entry(difference_text(objective, difference), difference.value)

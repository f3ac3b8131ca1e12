"""Tables of a search: its trials, and those that were trained again on fresh seeds."""

import math
from collections.abc import Iterator
from typing import Any

from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.tables.table import (
    Column,
    Entry,
    Table,
    column,
    interval_column,
    number,
    percent,
    record,
    setting,
    words,
)


def trials(report: ReportData) -> Iterator[Table]:
    """Yield the table of a search's trials."""
    tuning = report.tuning
    if tuning is None:
        return
    rows = [
        {
            **dict(zip(tuning.objectives, trial.values or [math.nan] * len(tuning.objectives), strict=True)),
            **{name: trial.parameters.get(name) for name in tuning.parameters},
            **record(trial),
            "label": trial.label,
        }
        for trial in tuning.trials
    ]
    yield Table(
        "trials",
        rows,
        [
            column("Trial", "number", number, numeric=False),
            column("State", "state", words, numeric=False),
            *(column(name, name, percent) for name in tuning.objectives),
            *(
                _parameter(name, kind.get("name") != "CategoricalDistribution")
                for name, kind in tuning.parameters.items()
            ),
            column("Env steps", "env_steps", number),
            column("CPU (s)", "cpu_s", number),
            *([column("Why it failed", "reason", words, numeric=False)] if any(row["reason"] for row in rows) else []),
        ],
        f"Trials: means over {tuning.n_seeds} tuning seeds (%), parameters, and what they took.",
        latex=True,
        noun="trials",
    )


def _parameter(name: str, numeric: bool) -> Column:
    """Return the column of a parameter, which conditions may have kept out of some trials."""

    def write(value: Any) -> Entry:
        if value is None:
            return Entry("")
        return Entry(f"{value:.3g}", value) if isinstance(value, float) else setting(value)

    return column(name, name, write, numeric=numeric)


def retest(report: ReportData) -> Iterator[Table]:
    """Yield the table of the trials that were trained again on fresh seeds."""
    tuning = report.tuning
    if tuning is None or not tuning.retested:
        return
    yield Table(
        "retest",
        [record(trial) for trial in tuning.retested],
        [
            column("Trial", "label", words, numeric=False),
            interval_column("Tuning seeds", "tuning"),
            interval_column("Fresh seeds", "test"),
            interval_column("Tuning minus test", "difference", formats.points_interval),
        ],
        f"Retrained trials: {tuning.objectives[0]} (%) on tuning seeds and on fresh ones, with 95 % intervals.",
        latex=True,
        noun="trials",
    )

"""The metrics that reports show: this package's and users' own."""

from collections.abc import Iterable
from typing import NamedTuple

from parking_exp.tasks.registry import METRICS, added_metrics


class ReportedMetric(NamedTuple):
    """A metric of reports.

    Attributes:
        name: of its mean over seeds, in `report.json` and in tables.
        column: in `Results.runs`.
        is_rate: whether it is a share of episodes.
        heading: in tables, with its unit.
    """

    name: str
    column: str
    is_rate: bool
    heading: str


OF_EVERY_TASK = ("success", "timeout", "episode_steps")
"""Names of metrics that a report has even where they are unknown."""
PACKAGE_METRICS = [
    ReportedMetric(
        name=metric.name if metric.is_rate else metric.run_column,
        column=metric.run_column,
        is_rate=metric.is_rate,
        heading=metric.heading,
    )
    for metric in METRICS
    if metric.in_reports
]


def reported_metrics(names: Iterable[str]) -> list[ReportedMetric]:
    """Return this package's metrics, then users' own among some columns or names.

    A user's metric is stored by its key alone, which serves as its name and its column.
    """
    metrics = [*PACKAGE_METRICS]
    for key in added_metrics(names):
        name, _, kind = key.rpartition("_")
        is_rate = kind == "rate"
        heading = f"{name} (%)" if is_rate else name
        metrics.append(ReportedMetric(key, key, is_rate, heading))
    return metrics

"""The metrics that reports show: their names, kinds and headings."""

from dataclasses import fields

from parking_exp.reports.report_data import RunSummary
from parking_exp.tasks.metrics import Metric
from parking_exp.tasks.registry import METRICS

REPORTED: dict[str, Metric] = {
    metric.name if metric.is_rate else metric.run_column: metric
    for metric in METRICS
    if metric.in_reports
}
"""Metrics of reports by their names in `CellSummary` and `RunSummary`."""
FIELDS = {field.name for field in fields(RunSummary)}
FURTHER = [name for name in REPORTED if name not in FIELDS]
"""Those without a field of their own, which only some tasks have."""


def is_rate(name: str) -> bool:
    """Return whether a metric of reports is a rate; the name of a user's is its key."""
    metric = REPORTED.get(name)
    return name.endswith("_rate") if metric is None else metric.is_rate


def heading(name: str) -> str:
    """Return the heading of a metric of reports; of a user's, the store has the name alone."""
    metric = REPORTED.get(name)
    if metric is not None:
        return metric.heading
    if is_rate(name):
        return f"{name.removesuffix('_rate')} (%)"
    return name.removesuffix("_mean")

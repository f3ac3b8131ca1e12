"""The tables of a report.

Each function yields what it has. Rows have the columns of `tables/*.csv`.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any

import pandas as pd

from parking_exp.config.settings import display_setting
from parking_exp.report_section import Column, Row, Table, cell_row
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.reported_metrics import ReportedMetric, reported_metrics
from parking_exp.reports.tables.table import (
    WITH_INTERVALS,
    cell_column,
    interval_column,
    row_of,
    text_column,
)
from parking_exp.tasks.metrics import STEPS


def headline_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of what each cell reached and what it cost."""
    columns = [
        cell_column(),
        Column("Seeds", "seeds", of_row=_count_finished, is_condition=True),
        Column("Env steps", "total_timesteps", formats.number, is_condition=True),
    ]
    for rate in _list_rates(report):
        columns.append(interval_column(rate.heading, rate.name, in_latex=rate.name != "timeout"))
    columns += [
        Column(
            "IQM",
            "iqm",
            formats.percent,
            note="interquartile mean of success over seeds",
            in_latex=False,
        ),
        Column(
            "Seeds ≥ 95 %",
            "reaching_95",
            of_row=_count_reaching_95,
            note="how many seeds ended at 95 % or above",
            in_latex=False,
        ),
        Column(
            "Steps to hold 90 %",
            "steps_to_90",
            formats.number,
            note="median of the env steps until 90 % were held for three evaluations",
        ),
        Column(
            STEPS.heading,
            STEPS.run_column,
            partial(formats.number, digits=1),
            in_latex=False,
        ),
        Column("CPU (s)", "cpu_s", formats.number),
    ]
    yield Table(
        "headline",
        _list_cell_rows(report),
        columns,
        f"Final evaluation: means over seeds, {WITH_INTERVALS}.",
        latex=True,
    )


def means_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of the further means of each cell, such as the length of the driven path."""
    columns = [cell_column()]
    write = partial(formats.number, digits=2)
    for metric in _list_metrics(report):
        if not metric.is_rate and metric.name != STEPS.run_column:
            columns.append(Column(metric.heading, metric.name, write))
    if len(columns) == 1:
        return
    yield Table(
        "means", _list_cell_rows(report), columns, "Final evaluation: other means over seeds."
    )


def times_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of how long each cell took to hold 90 %, and of the area under its curve."""
    rows = [row for row in _list_cell_rows(report) if row["n_timed"]]
    yield Table(
        "times",
        rows,
        [
            cell_column(),
            Column("Reached", "n_reached_90", of_row=_count_reached),
            Column("Median (steps)", "steps_to_90", formats.number),
            Column("Median (CPU-s)", "cpu_s_to_90", formats.number),
            interval_column("AUC (%)", "area"),
        ],
        "Time until three evaluations in a row have 90 %, with medians where half of the seeds "
        "reached it; area under the learning curve in % of the highest possible, means "
        f"{WITH_INTERVALS}.",
    )


def seeds_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of the finished runs."""
    columns = [
        cell_column(),
        Column("Seed", "seed"),
    ]
    for rate in _list_rates(report):
        columns.append(Column(rate.heading, rate.name, formats.percent))
    columns += [
        Column("Episodes", "n_episodes", formats.number, is_condition=True),
        Column("Steps to 90 %", "steps_to_90", formats.number),
        Column("CPU (s)", "cpu_s", formats.number),
        text_column("Run", "run_id"),
    ]
    rows = []
    for cell in report.cells:
        for seed in cell.seeds:
            rows.append(cell_row(cell) | row_of(seed) | row_of(seed.metrics))
    yield Table(
        "seeds",
        rows,
        columns,
        "Finished runs: final rates over the evaluation episodes.",
        folded=True,
    )


def curves_table(report: ReportData) -> Iterator[Table]:
    """Yield the CSV of the learning curves."""
    rows: list[Row] = []
    for cell in report.cells:
        curve = cell.curve
        if curve is None:
            continue
        points: Any = pd.DataFrame(
            {
                "step": curve.step,
                "n": curve.n,
                "success": curve.mean,
                "success_low": curve.low,
                "success_high": curve.high,
                "failure": curve.failure,
            }
        )
        rows += [cell_row(cell) | point for point in points.to_dict("records")]
    yield Table("curves", rows)


def pairs_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of the pairs of cells that were compared."""
    rows = []
    for pair in report.pairs:
        labels = {"a_label": report.labels[pair.a], "b_label": report.labels[pair.b]}
        row = labels | row_of(pair)
        row["p"] = pair.difference.p
        row["p_corrected"] = pair.difference.p_corrected
        rows.append(row)
    yield Table(
        "pairs",
        rows,
        [
            cell_column("A", "a", "a_label"),
            cell_column("B", "b", "b_label"),
            interval_column("A − B (points)", "difference", formats.points_interval),  # noqa: RUF001
            Column("p (Bonferroni)", "p_corrected", formats.p_value),
            Column(
                "p, ranks (Bonferroni)",
                "rank_p",
                formats.p_value,
                note="Mann and Whitney's test of the ranks of seeds, a second opinion",
            ),
            text_column(
                "In words",
                "verdict",
                lambda verdict: formats.VERDICTS[verdict].table,
                in_latex=False,
            ),
        ],
        "Pairs of cells: difference of mean final success in percentage points, with simultaneous "
        "95 % intervals.",
        latex=True,
        folded=not report.drawn_pairs,
    )


def factors_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of the difference that each factor makes."""
    rows = []
    for effect in report.effects_by_size:
        row = row_of(effect)
        row["name"] = report.factor_names[effect.factor]
        row["highest"] = effect.highest.level
        row["lowest"] = effect.lowest.level
        row["p_corrected"] = effect.largest.p_corrected
        rows.append(row)
    yield Table(
        "factors",
        rows,
        [
            text_column("Factor", "name"),
            text_column("Highest", "highest", display_setting),
            text_column("Lowest", "lowest", display_setting),
            interval_column("Highest − lowest (points)", "largest", formats.points_interval),  # noqa: RUF001
            Column("p (Bonferroni)", "p_corrected", formats.p_value),
        ],
        "Factors: the levels with the highest and the lowest mean over the other factors, and "
        "their difference in percentage points, with 95 % intervals.",
        latex=True,
    )


def effects_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of each factor's levels."""
    rows = []
    for effect in report.effects:
        for level in effect.levels:
            rows.append(row_of(effect) | row_of(level))
    yield Table(
        "effects",
        rows,
        [
            text_column("Factor", "factor"),
            text_column("Level", "level", display_setting),
            interval_column("Success (%)", "effect"),
            Column("Cells", "cells", formats.number),
        ],
        "Main effects: mean final success at each level over the levels of the other factors, "
        f"{WITH_INTERVALS}.",
        latex=True,
    )


def config_table(report: ReportData) -> Iterator[Table]:
    """Yield the settings that differ: a row for each cell, or each setting if these are more."""
    difference = report.provenance.difference
    if not difference:
        return
    rows: list[dict[str, Any]] = []
    if len(difference) > len(report.cells):
        columns = [text_column("Setting", "setting")]
        columns += [text_column(cell.label, cell.id, display_setting) for cell in report.cells]
        for key, values in difference.items():
            by_cell = zip(report.labels, values, strict=True)
            rows.append({"setting": key, **dict(by_cell)})
    else:
        columns = [cell_column()]
        columns += [text_column(key, key, display_setting) for key in difference]
        for number, cell in enumerate(report.cells):
            levels = {key: values[number] for key, values in difference.items()}
            rows.append({**cell_row(cell), **levels})
    yield Table(
        "config",
        rows,
        columns,
        "Settings that are not the same in all cells.",
        latex=True,
    )


def versions_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of versions, commits and machines."""
    origin = report.provenance
    counted = {**origin.versions, "commit": origin.commits, "machine": origin.machines}
    rows = []
    for what, counts in counted.items():
        rows += [{"what": what, "version": name, "runs": n} for name, n in counts.items()]
    yield Table(
        "versions",
        rows,
        [
            text_column("What", "what"),
            text_column("Version", "version"),
            Column("Runs", "runs", formats.number, is_condition=True),
        ],
        "Versions, commits and machines.",
    )


def unfinished_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of the runs without a result, and why."""
    rows = [row_of(run) for run in report.provenance.unfinished]
    yield Table(
        "unfinished",
        rows,
        [
            text_column("Cell", "label"),
            Column("Seed", "seed"),
            text_column("Status", "status"),
            text_column("Reason", "reason"),
        ],
        "Runs without a result, and why.",
    )


def common_table(report: ReportData) -> Iterator[Table]:
    """Yield the table of the settings that are the same in all cells."""
    rows = [{"key": key, "value": value} for key, value in report.provenance.common.items()]
    yield Table(
        "common",
        rows,
        [text_column("Setting", "key"), text_column("Value", "value", display_setting)],
        "Settings that are the same in all cells.",
        folded=True,
    )


def _list_cell_rows(report: ReportData) -> list[Row]:
    rows: list[Row] = []
    for cell in report.cells:
        row = cell_row(cell)
        # A run that is done may lack its rate.
        row["seeds"] = cell.success.n
        for stage, n_runs in cell.counts.items():
            row[f"runs_{stage}"] = n_runs
        numbers = row_of(cell, without=("id", "label", "figure_data"))
        rows.append(row | numbers | row_of(cell.metrics))
    return rows


def _list_metrics(report: ReportData) -> list[ReportedMetric]:
    """Return the metrics that some cell has, users' own metrics last."""
    names: set[str] = set()
    for cell in report.cells:
        names.update(cell.metrics)
    return [metric for metric in reported_metrics(names) if metric.name in names]


def _list_rates(report: ReportData) -> list[ReportedMetric]:
    """Return the rates that some cell has, the rate of timeouts last."""
    rates = [metric for metric in _list_metrics(report) if metric.is_rate]
    return sorted(rates, key=lambda rate: rate.name == "timeout")


def _count_finished(row: Row) -> str:
    done = row["seeds"]
    total = sum(count or 0 for key, count in row.items() if key.startswith("runs_"))
    return str(done) if done == total else f"{done} of {total}"


def _count_reaching_95(row: Row) -> str:
    return f"{row['reaching_95']}/{row['seeds']}" if row["seeds"] else ""


def _count_reached(row: Row) -> str:
    return f"{row['n_reached_90']}/{row['n_timed']}"

"""Exports of reports: a folder of small files that the whole report can be made from again, without the store."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from parking_exp.errors import ResultsError
from parking_exp.reports.cell_summaries import RunEvaluations
from parking_exp.reports.lot_map import sampled_rows
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.search_report import Tuning
from parking_exp.results.frame_export import REPORT, read_export, without_paths, write_export
from parking_exp.results.frames import Results

IN_FRAMES = ("seeds", "curve", "survival", "survival_cpu", "slots", "failures", "paths")
"""What report.json leaves out of each cell: the frames have it."""
DIGITS = 6


class ReportSource(NamedTuple):
    """What a report is made of: results of experiments, their names, and the search that an export has."""

    results: Results
    experiments: list[str]
    tuning: Tuning | None = None


def write_report_export(
    source: ReportSource, report: ReportData, folder: Path, command: str, *, only_cells: bool
) -> None:
    """Write the export of a report: with `only_cells`, the runs of its cells and not all of the experiments.

    `command` is how to make the report from the export.
    """
    results = _of_cells(source.results, report) if only_cells else source.results
    final = RunEvaluations.of(results).final
    trajectories, problems = {}, []
    for cell in report.shown_cells:
        rows, unread = sampled_rows([(seed.seed, seed.run_id) for seed in cell.seeds], results, final)
        trajectories.update(rows)
        problems += unread
    about = {
        "experiments": list(source.experiments),
        "report": {**_summary(report), "command": command},
    }
    write_export(results, folder, trajectories, _plain(about), problems)


def read_report_export(folder: str) -> ReportSource:
    """Return what the export of a report has.

    Raises:
        ResultsError: it is not there, or can't be read.
    """
    results = read_export(folder)
    try:
        experiments = TypeAdapter(list[str]).validate_python(results.about["experiments"])
        tuning = TypeAdapter(Tuning | None).validate_python(results.about["report"].get("tuning"))
    except (ValidationError, KeyError, AttributeError) as error:
        raise ResultsError(f"{Path(folder) / REPORT} can't be read: it is no description of a report") from error
    return ReportSource(results, experiments, tuning)


def _of_cells(results: Results, report: ReportData) -> Results:
    """Return the results of the report's cells alone."""
    cells = {(cell.experiment, cell.name) for cell in report.cells}
    kept = [pair in cells for pair in zip(results.runs["experiment"], results.runs["cell"], strict=True)]
    runs = results.runs[kept].reset_index(drop=True)
    curves, episodes = (frame[frame["run_id"].isin(runs["run_id"])] for frame in (results.curves, results.episodes))
    return replace(results, runs=runs, curves=curves, episodes=episodes)


def _summary(report: ReportData) -> dict[str, Any]:
    """Return what a report says, without what the frames of its export have, and without when and where it was made."""
    summary = {key: value for key, value in report.plain().items() if key not in ("made", "provenance")}
    cells = [{key: value for key, value in cell.items() if key not in IN_FRAMES} for cell in summary["cells"]]
    return {**summary, "cells": cells}


def _plain(value: Any) -> Any:
    """Return what JSON has, numbers rounded to 6 significant digits and absolute paths cut to their last part."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return without_paths(value) if isinstance(value, str) else value

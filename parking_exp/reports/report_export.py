"""Exports of reports: a folder of small files that the whole report can be made from again, without the store."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, TypeAdapter, ValidationError

from parking_exp.errors import ResultsError
from parking_exp.reports.lot_map import sampled_rows
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.run_evaluations import RunEvaluations
from parking_exp.reports.search_report import Tuning
from parking_exp.results.frame_export import REPORT, read_export, without_paths, write_export
from parking_exp.results.frames import Results

IN_FRAMES = {
    "cells": ("seeds", "curve", "slots", "failures", "paths"),
    "survival": ("time", "reached", "low", "high", "censored"),
    "pairs": ("note",),
    "unfinished": ("run_dir",),
}
"""What report.json leaves out of each cell, survival curve, pair and unfinished run: the frames have it, or a warning,
or it is a place on the machine."""
DIGITS = 6


class ReportSource(NamedTuple):
    """What a report is made of: results of experiments, their names, and the search that an export has."""

    results: Results
    experiments: list[str]
    tuning: Tuning | None = None


class _ReportEntries(BaseModel):
    """What `report.json` has to have for a report."""

    experiments: list[str]


def write_report_export(
    source: ReportSource, report: ReportData, folder: Path, command: str, *, only_cells: bool
) -> None:
    """Write the export of a report.

    Args:
        source: what the report was made of.
        report: what it says.
        folder: see `write_export`.
        command: how to make the report from the export.
        only_cells: whether it has the runs of the report's cells alone, and not all of the experiments.
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
        described = _ReportEntries.model_validate(results.about)
        tuning = TypeAdapter(Tuning | None).validate_python(results.about["report"].get("tuning"))
    except (ValidationError, KeyError, AttributeError) as error:
        raise ResultsError(f"{Path(folder) / REPORT} can't be read: it is no description of a report") from error
    return ReportSource(results, described.experiments, tuning)


def _of_cells(results: Results, report: ReportData) -> Results:
    """Return the results of the report's cells alone."""
    cells = {(cell.experiment, cell.name) for cell in report.cells}
    kept = [pair in cells for pair in zip(results.runs["experiment"], results.runs["cell"], strict=True)]
    runs = results.runs[kept].reset_index(drop=True)
    curves, episodes = (frame[frame["run_id"].isin(runs["run_id"])] for frame in (results.curves, results.episodes))
    return replace(results, runs=runs, curves=curves, episodes=episodes)


def _summary(report: ReportData) -> dict[str, Any]:
    """Return what a report says, without what the frames of its export have, and without when and where it was made."""
    summary = report.plain()
    clocks = [cell[name] for cell in summary["cells"] for name in ("survival", "survival_cpu") if cell[name]]
    items = {"survival": clocks, "unfinished": summary["provenance"]["unfinished"], **summary}
    for kind, names in IN_FRAMES.items():
        for item in items[kind]:
            for name in names:
                del item[name]
    del summary["made"], summary["provenance"]["uri"], summary["provenance"]["common"]
    return summary


def _plain(value: Any) -> Any:
    """Return what JSON has, numbers rounded to 6 significant digits and absolute paths cut to their last part."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return without_paths(value) if isinstance(value, str) else value

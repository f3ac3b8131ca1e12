"""Exports of reports: a folder of small files that the whole report can be made from again, without the store."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from parking_exp.errors import ResultsError
from parking_exp.reports.curves import RunEvaluations
from parking_exp.reports.lot_map import sampled_rows
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.tuning_data import Tuning
from parking_exp.results.frame_export import REPORT, read_export, without_paths, write_export
from parking_exp.results.frames import Results

IN_TABLES = ("seeds", "curve", "slots", "failures", "paths")
"""Entries of a `Cell` that are left out of report.json: they are computed from the tables again."""
ARRAYS = ("time", "reached", "low", "high", "censored")
"""Entries of a `Survival` that are, too."""
DIGITS = 6


@dataclass(frozen=True)
class ReportSource:
    """What a report is made of.

    Attributes:
        results: of its experiments.
        experiments: their names.
        unsynced: a sentence for each thing that kept the store from being brought up to date.
        tuning: the search that an export has.
    """

    results: Results
    experiments: list[str]
    unsynced: Sequence[str] = ()
    tuning: Tuning | None = None


class _ReportEntries(BaseModel):
    """What `report.json` has to have for a report."""

    experiments: list[str]


def write(material: ReportSource, report: ReportData, folder: Path, command: str, *, only_cells: bool) -> None:
    """Write the export of a report.

    Args:
        material: what the report was made of.
        report: what it says.
        folder: see `write_export`.
        command: how to make the report from the export.
        only_cells: whether it has the runs of the report's cells alone, and not all of the experiments.
    """
    results = _of_cells(material.results, report) if only_cells else material.results
    final = RunEvaluations.of(results).final
    trajectories, problems = {}, list(material.unsynced)
    for cell in report.shown_cells:
        rows, unread = sampled_rows([(seed.seed, seed.run_id) for seed in cell.seeds], results, final)
        trajectories.update(rows)
        problems += unread
    about = {
        "experiments": list(material.experiments),
        "report": {**_summary(report), "command": command},
    }
    write_export(results, folder, trajectories, _plain(about), problems)


def read(folder: str) -> ReportSource:
    """Return what the export of a report has.

    Raises:
        ResultsError: it is not there, or can't be read.
    """
    results = read_export(folder)
    try:
        described = _ReportEntries.model_validate(results.about)
        tuning = results.about["report"].get("tuning")
        search = None if tuning is None else TypeAdapter(Tuning).validate_python(tuning)
    except (ValidationError, KeyError, AttributeError) as error:
        raise ResultsError(f"{Path(folder) / REPORT} can't be read: it is no description of a report") from error
    return ReportSource(results, described.experiments, tuning=search)


def _of_cells(results: Results, report: ReportData) -> Results:
    """Return the results of the report's cells alone."""
    cells = {(cell.experiment, cell.name) for cell in report.cells}
    runs = results.runs
    kept = [pair in cells for pair in zip(runs["experiment"], runs["cell"], strict=True)]
    ids = set(runs.loc[kept, "run_id"])
    return replace(
        results,
        runs=runs[kept].reset_index(drop=True),
        curves=results.curves[results.curves["run_id"].isin(ids)],
        episodes=results.episodes[results.episodes["run_id"].isin(ids)],
    )


def _summary(report: ReportData) -> dict[str, Any]:
    """Return what a report says, without what the tables of its export have, and without when and where it was made."""
    found = report.plain()
    for cell in found["cells"]:
        for name in IN_TABLES:
            del cell[name]
        for survival in filter(None, (cell["survival"], cell["survival_cpu"])):
            for name in ARRAYS:
                del survival[name]
    for pair in found["pairs"]:
        del pair["note"]  # the warnings have it
    for run in found["provenance"]["unfinished"]:
        del run["run_dir"]
    del found["made"], found["provenance"]["uri"], found["provenance"]["common"]
    return found


def _plain(value: Any) -> Any:
    """Return what JSON has, numbers rounded to 6 significant digits and absolute paths cut to their last part."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return without_paths(value) if isinstance(value, str) else value

"""Make a report that compares an experiment's cells, from a store or an export, and export it."""

import json
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from filelock import FileLock
from pydantic import TypeAdapter, ValidationError

from parking_exp.config.paths import absolute_path, default_uri, refuse_links
from parking_exp.errors import ConfigError, ResultsError
from parking_exp.phrases import plural
from parking_exp.report_section import Section
from parking_exp.reports.report_builder import build_report
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.report_files import write_report
from parking_exp.reports.report_request import ReportRequest
from parking_exp.reports.search_report import with_search, with_stored_search
from parking_exp.reports.sections import load_sections
from parking_exp.results.frame_export import (
    REPORT,
    read_export,
    refuse_foreign,
    without_paths,
    write_export,
)
from parking_exp.results.frames import Results, load, read_store
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import experiment_of, find_runs
from parking_exp.terminal import command_of, make_console, say
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import complete_store
from parking_exp.tuning.search import StoredSearch


class ReportSource(NamedTuple):
    """What a report is made of: results of experiments, and an export's search."""

    results: Results
    search: StoredSearch | None = None


def make_report(request: ReportRequest) -> None:
    """Complete the store, write the report, export it if asked to, and print the findings."""
    export_folder = absolute_path(request.export) if request.export else None
    if export_folder:
        refuse_foreign(export_folder)
    user_sections = load_sections(request.report.sections)
    with make_console(stderr=True).status("") as progress:
        source = _read_source(request, progress.update)
        progress.update(f"comparing {plural(len(source.results.runs), 'run')}")
        report = _build_content(request, source)
        progress.update("drawing")
        folder = _write_files(request, report, user_sections)
        if export_folder:
            progress.update("exporting")
            write_report_export(source, report, export_folder, only_cells=bool(request.cells_asked))

    say(*report.claims, *report.missing)
    say(*(f"warning: {sentence}" for sentence in report.warnings), stderr=True)
    if export_folder:
        say(f"export         {export_folder}")
    say(f"report         {folder / 'index.html'}")


def _read_source(request: ReportRequest, show: Callable[[str], None]) -> ReportSource:
    """Read the export or the store; the output directory's own store is completed first."""
    if request.source is not None:
        show("reading the export")
        return read_report_export(request.source)
    if request.tracking.uri:
        show("reading the store")
        results = load(request.experiments, uri=request.tracking.uri)
    else:
        results = _read_own_store(request, show)
    names = results.runs["experiment"].unique()
    if request.experiments is None and len(names) > 1:
        raise ConfigError(
            f"experiment: the store has several; name one or more of {', '.join(names)}"
        )
    return ReportSource(results)


def _read_own_store(request: ReportRequest, show: Callable[[str], None]) -> Results:
    """Send the store of the output directory what it lacks, and read it."""
    show("sending to the store what it lacks")
    names = request.experiments
    paths = [
        path for path in find_runs(request.output_path) if not names or experiment_of(path) in names
    ]
    store = Store(default_uri(request.output_path), request.output_path)
    problem = complete_store(map(RunDirectory, paths), store)

    show("reading the store")
    results = read_store(store, request.experiments)
    if problem:
        return replace(results, problems=(f"{problem}.", *results.problems))
    return results


def _build_content(request: ReportRequest, source: ReportSource) -> ReportData:
    report = build_report(
        source.results,
        request.experiments or list(source.results.runs["experiment"].unique()),
        cells=request.cells_asked,
        baseline=request.baseline,
        contrast=request.contrast,
        quick=request.report.quick,
        command=shlex.join([*command_of("report").split(), *sys.argv[1:]]),
    )
    if request.source is None:
        return with_stored_search(report, request.output_path)
    return with_search(report, source.search) if source.search else report


def _write_files(
    request: ReportRequest, report: ReportData, user_sections: Sequence[Section]
) -> Path:
    """Write a report into the output directory, and return its folder."""
    # In a store, experiments may be called anything.
    name = request.name or re.sub(r"[^\w.+-]|^\.", "_", "+".join(report.experiments))
    folder = request.output_path / "reports" / name
    refuse_links([folder.parent, folder], request.output_path)
    refuse_links(folder.rglob("*"), folder)
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".lock"):
        write_report(report, folder, request.report.formats, user_sections)
    return folder


def write_report_export(
    source: ReportSource, report: ReportData, folder: Path, *, only_cells: bool
) -> None:
    """Write the export of a report: all of its experiments, or the runs of its cells alone."""
    results = _select_cells(source.results, report) if only_cells else source.results
    search = json.loads(without_paths(json.dumps(report.plain()["tuning"])))
    write_export(results, folder, {"report": {"tuning": search}})


def read_report_export(folder: str) -> ReportSource:
    """Return what the export of a report has."""
    results = read_export(folder)
    try:
        stored = results.about.get("report", {}).get("tuning")
        search = TypeAdapter(StoredSearch | None).validate_python(stored)
    except (ValidationError, AttributeError) as error:
        path = Path(folder) / REPORT
        raise ResultsError(f"{path} can't be read: it does not describe a report") from error
    return ReportSource(results, search)


def _select_cells(results: Results, report: ReportData) -> Results:
    """Return the results of a report's cells."""
    cells = [(cell.experiment, cell.name) for cell in report.cells]
    runs = results.runs.set_index(["experiment", "cell"], drop=False)
    runs = runs[runs.index.isin(cells)].reset_index(drop=True)
    curves = results.curves[results.curves["run_id"].isin(runs["run_id"])]
    episodes = results.episodes[results.episodes["run_id"].isin(runs["run_id"])]
    return replace(results, runs=runs, curves=curves, episodes=episodes)

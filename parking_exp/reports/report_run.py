"""Make a report that compares an experiment's cells: page, Markdown, tables, figures, JSON."""

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from filelock import FileLock
from omegaconf import DictConfig

from parking_exp.config.paths import default_uri, directory_path, refuse_links
from parking_exp.errors import ConfigError, plural
from parking_exp.reports.report_request import ReportRequest, validate_report
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.terminal import console, say

if TYPE_CHECKING:
    from parking_exp.reports.report_data import ReportData
    from parking_exp.reports.report_export import ReportSource


def report(config: DictConfig) -> Path:
    """Write a report, print what it says, and return its folder.

    Raises:
        ConfigError: there is no such cell or baseline.
        ResultsError: the store can't be read, or has no such runs.
        RunNotFoundError: none of the runs is done.
        UntrustedError: a symbolic link leads out of the report's folder.
    """
    request = validate_report(config)
    exported = directory_path(request.export) if request.export else None
    if exported:
        from parking_exp.results.frame_export import refuse_foreign

        refuse_foreign(exported)
    with console(stderr=True).status("") as progress:
        source = _source(request, progress.update)
        progress.update(f"comparing {plural(len(source.results.runs), 'run')}")
        data = _content(request, source)
        progress.update("drawing")
        folder = request.output_path / "reports" / (request.name or _folder_name(data.experiments))
        _write(data, folder, request)
        if exported:
            progress.update("exporting")
            _export(request, source, data, exported)
    say(*data.claims, *data.missing)
    say(*(f"warning: {sentence}" for sentence in data.warnings), stderr=True)
    if exported:
        say(f"export         {exported}")
    say(f"report         {folder / 'index.html'}")
    return folder


def _source(request: ReportRequest, show: Callable[[str], None]) -> "ReportSource":
    """Return what the export has or, after it got what it lacks, the store.

    Raises:
        ConfigError: the store has several experiments, and none is named.
        ResultsError: it can't be read, or has none of them.
    """
    from parking_exp.reports.report_export import ReportSource, read_report_export
    from parking_exp.results.frames import load, read_store
    from parking_exp.tracking.mirror import mirror_problem
    from parking_exp.tracking.store import Store

    if request.source is not None:
        show("reading the export")
        return read_report_export(request.source)
    if request.tracking.uri:
        show("reading the store")
        results = load(request.experiments, uri=request.tracking.uri)
    else:
        show("sending to the store what it lacks")
        paths = [path for name in request.experiments or [""] for path in find_runs(request.output_path, name or None)]
        store = Store(default_uri(request.output_path), request.output_path)
        problem = mirror_problem(map(RunDirectory, paths), store)
        show("reading the store")
        results = read_store(store, request.experiments)
        results = replace(results, problems=(*([f"{problem}."] if problem else []), *results.problems))
    having = list(dict.fromkeys(results.runs["experiment"]))
    if request.experiments is None and len(having) > 1:
        raise ConfigError(f"experiment: the store has several; name one or more of {', '.join(having)}")
    return ReportSource(results, request.experiments or having)


def _content(request: ReportRequest, source: "ReportSource") -> "ReportData":
    from parking_exp.reports.report_builder import build_report
    from parking_exp.reports.search_report import with_search, with_tuning

    data = build_report(
        source.results,
        source.experiments,
        cells=request.cells_asked,
        baseline=request.baseline,
        quick=request.report.quick,
        command=_command(request, source.experiments),
    )
    if request.source is None:
        return with_search(data, request.output_path, request.storage)
    return with_tuning(data, source.tuning) if source.tuning else data


def _write(data: "ReportData", folder: Path, request: ReportRequest) -> None:
    from parking_exp.reports.report_files import write_report  # with matplotlib: not before there is something to draw

    refuse_links([folder.parent, folder], request.output_path)
    refuse_links(folder.rglob("*"), folder)
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / ".lock"):
        write_report(data, folder, request.report.formats)


def _export(request: ReportRequest, source: "ReportSource", data: "ReportData", folder: Path) -> None:
    from parking_exp.reports.report_export import write_report_export

    here = Path().absolute()
    words = [f"from={folder.relative_to(here) if folder.is_relative_to(here) else folder.name}"]
    if data.baseline:
        words.append(f"baseline={data.cell(data.baseline).label}")
    if data.quick:
        words.append("report=quick")
    command = shlex.join(["python", "scripts/report.py", *words])
    write_report_export(source, data, folder, command, only_cells=bool(request.cells_asked))


def _folder_name(experiments: Sequence[str]) -> str:
    """Return a name that is a folder's and nothing else: in a store, experiments may be called anything."""
    return re.sub(r"[^\w.+-]|^\.", "_", "+".join(experiments))


def _command(request: ReportRequest, experiments: Sequence[str]) -> str:
    """Return the command that makes this report."""
    where = f"from={request.source}" if request.source else f"experiment={','.join(experiments)}"
    values = {
        "baseline": request.baseline,
        "report": "quick" if request.report.quick else None,
        "output_dir": request.output_dir if request.output_path != Path("outputs").absolute() else None,
        "tracking.uri": request.tracking.uri,
        "storage": request.storage,
        "name": request.name,
    }
    keys = [f"{key}={value}" for key, value in values.items() if value]
    return shlex.join(["python", "scripts/report.py", where, *request.cells_asked, *keys])

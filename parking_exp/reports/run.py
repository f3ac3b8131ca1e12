"""Generate a report that compares an experiment's cells: page, Markdown, tables, figures, JSON."""

import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from filelock import FileLock
from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config.compose import composed
from parking_exp.config.paths import absolute, database, default_uri, directory_path, is_same_store, without_password
from parking_exp.config.schema import ConfigModel, StoreConfig
from parking_exp.config.signatures import signature
from parking_exp.config.validate import parse
from parking_exp.errors import ConfigError, ResultsError, did_you_mean, plural
from parking_exp.terminal import say

if TYPE_CHECKING:
    from parking_exp.reports.report_data import ReportData
    from parking_exp.results.frames import Results

Format = Literal["svg", "pdf", "png"]
ALIKE = 0.8  # from how similar on a word is a misspelt key


class ReportOptions(ConfigModel):
    """The `report` group."""

    quick: bool
    formats: list[Format]


class ReportRequest(ConfigModel):
    """The config of scripts/report.py."""

    experiment_name: str | list[str] | None
    cells: str | list[str] | None
    baseline: str | None
    output_dir: str
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$", max_length=200)] | None
    tracking: StoreConfig
    report: ReportOptions

    @property
    def output_path(self) -> Path:
        """Absolute output directory."""
        return directory_path(self.output_dir)

    @property
    def cells_asked(self) -> list[str]:
        """Labels, patterns and conditions."""
        return [self.cells] if isinstance(self.cells, str) else self.cells or []


def validate_report(config: DictConfig) -> ReportRequest:
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with a sentence for each thing that is wrong.
    """
    request = parse(ReportRequest, config)
    conditions = [one.partition("=")[0] for one in request.cells_asked if "=" in one]
    if conditions:
        _refuse_misspelt(conditions)
    return request


def _refuse_misspelt(typed: Sequence[str]) -> None:
    """Refuse what is nearly a key of this command or of a run's config. A run's own class may have any arguments.

    Raises:
        ConfigError: a key that is misspelt, with the closest one.
    """
    run_keys = {ending for key in _config_keys() for ending in _endings(key)}
    known = {*ReportRequest.model_fields, "experiment", *run_keys}
    for key in typed:
        own = key.startswith(("algorithm.", "buffer."))
        if key not in known and not own and (hint := did_you_mean(key, known, cutoff=ALIKE)):
            raise ConfigError(f"{key}: there is no such key{hint}")


def _config_keys() -> Iterator[str]:
    """Yield the dotted keys of the default run, and the arguments that its classes have besides."""
    nodes: list[tuple[str, Any]] = [("", composed("config", [])[0])]
    for name, node in nodes:
        yield name
        if isinstance(node, DictConfig):
            nodes += [(f"{name}.{key!s}".removeprefix("."), value) for key, value in node.items()]
            if "_target_" in node:
                yield from (f"{name}.{argument}" for argument in signature(node["_target_"]).parameters)


def _endings(key: str) -> list[str]:
    parts = key.split(".")
    return [".".join(parts[start:]) for start in range(len(parts))]


def report(config: DictConfig) -> Path:
    """Write a report, print what it says, and return its folder.

    Raises:
        ConfigError: a cell or baseline that there is not.
        ResultsError: the store can't be read, or has no such runs.
        RunNotFoundError: none of the runs is done.
    """
    request = validate_report(config)
    with _progress() as show:
        show("syncing the store")
        unsynced = _sync(request)
        show("reading the store")
        results = _load(request)
        show(f"comparing {plural(len(results.runs), 'run')}")
        data = _build(request, results, unsynced)
        show("drawing")
        from parking_exp.reports.render.files import write  # with matplotlib: not before there is something to draw

        folder = request.output_path / "reports" / (request.name or _folder_name(data.experiments))
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder / ".lock"):
            write(data, folder, request.report.formats)
    _print(data, folder)
    return folder


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Yield a function that shows on a terminal what is being done."""
    from rich.progress import Progress, SpinnerColumn, TextColumn

    from parking_exp.terminal import console

    screen = console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=screen, transient=True, disable=not screen.is_terminal) as bar:
        task = bar.add_task("")

        def show(what: str) -> None:
            bar.update(task, description=what)

        yield show


def _build(request: ReportRequest, results: "Results", unsynced: Sequence[str]) -> "ReportData":
    from parking_exp.reports.build import Question, build
    from parking_exp.reports.tuning import with_search
    from parking_exp.reports.untracked import find_untracked

    having = list(dict.fromkeys(results.runs["experiment"]))
    if request.experiment_name is None and len(having) > 1:
        raise ConfigError(f"experiment: the store has several; name one or more of {', '.join(having)}")
    question = Question(
        experiments=_experiments(request) or having,
        cells=request.cells_asked,
        baseline=request.baseline,
        quick=request.report.quick,
        command=_command(request, _experiments(request) or having),
    )
    data = build(results, question, find_untracked(results.runs, request.output_path, having), unsynced)
    return with_search(data, request.output_path)


def _experiments(request: ReportRequest) -> list[str] | None:
    named = request.experiment_name
    return [named] if isinstance(named, str) else named


def _folder_name(experiments: Sequence[str]) -> str:
    """Return a name that is a folder's and nothing else: in a store, experiments may be called anything."""
    return re.sub(r"[^\w.+-]|^\.", "_", "+".join(experiments))


def _sync(request: ReportRequest) -> list[str]:
    """Send what the embedded store lacks of the runs in the output directory; say what it still lacks.

    Nothing is sent to a store that is typed.
    """
    from parking_exp.reports.untracked import run_paths
    from parking_exp.runs.directory import RunDirectory
    from parking_exp.tracking.sync import recorded_in_step
    from parking_exp.tracking.sync_all import sync_all
    from parking_exp.tracking.tracker import later

    embedded = default_uri(request.output_path)
    uri = absolute(request.tracking.uri) if request.tracking.uri else embedded
    lost = (path := database(uri)) is not None and not path.exists()
    behind = [
        directory
        for directory in map(RunDirectory, run_paths(request.output_path, _experiments(request)))
        if (own := directory.tracking_uri) and is_same_store(own, uri) and (lost or not recorded_in_step(directory))
    ]
    if not is_same_store(uri, embedded):
        older = f"The store has an older state of {plural(len(behind), 'run')} in {request.output_path}"
        return [f"{older}; {later(request.output_path, uri)}."] if behind else []
    problems: dict[str, list[RunDirectory]] = {}
    for directory, problem in sync_all(behind, [uri]):
        if problem is not None:
            problems.setdefault(problem, []).append(directory)
    return [
        f"The store has not got all of {plural(len(runs), 'run')}, e.g. {runs[0].path}: {problem}."
        for problem, runs in problems.items()
    ]


def _load(request: ReportRequest) -> "Results":
    """Load the results.

    Raises:
        ResultsError: there are none; it says how far the runs in the output directory are.
    """
    from parking_exp.reports.untracked import run_paths
    from parking_exp.results.frames import load
    from parking_exp.runs.state import read_state
    from parking_exp.runs.state_tables import name

    experiments = _experiments(request)
    try:
        return load(experiments, uri=request.tracking.uri, output_dir=request.output_path)
    except ResultsError as error:
        here = [read_state(path) for path in run_paths(request.output_path, experiments or [])]
        if failed := [state for state in here if state.stage == "failed"]:
            reason = f"{plural(len(failed), 'run')} of it failed, e.g. {name(failed[0])}: {failed[0].reason}"
            raise ResultsError(f"{error}; {reason}") from error
        if here:
            hint = "`python scripts/status.py` tells how far that is, and with sync=true sends it to the store"
            raise ResultsError(
                f"{error}; {plural(len(here), 'run')} of it {'is' if len(here) == 1 else 'are'} here: {hint}"
            ) from error
        raise


def _command(request: ReportRequest, experiments: Sequence[str]) -> str:
    """Return the command that makes this report."""
    words = ["python", "scripts/report.py", f"experiment={','.join(experiments)}", *request.cells_asked]
    if request.baseline:
        words.append(f"baseline={request.baseline}")
    if request.report.quick:
        words.append("report=quick")
    if request.output_path != Path("outputs").absolute():
        words.append(f"output_dir={request.output_dir}")
    if request.tracking.uri:
        words.append(f"tracking.uri={without_password(request.tracking.uri)}")
    if request.name:
        words.append(f"name={request.name}")
    return shlex.join(words)


def _print(data: "ReportData", folder: Path) -> None:
    """Say on the terminal what the report says in its first lines."""
    say(*data.claims, *data.missing)
    say(*(f"warning: {sentence}" for sentence in data.warnings), stderr=True)
    say(f"report         {folder / 'index.html'}")

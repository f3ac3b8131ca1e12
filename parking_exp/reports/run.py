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
from parking_exp.config.paths import directory_path, refuse_links
from parking_exp.config.schema import ConfigModel, StoreConfig
from parking_exp.config.validate import parse
from parking_exp.errors import ConfigError, did_you_mean, plural
from parking_exp.terminal import say
from parking_exp.tuning.search_config import Storage

if TYPE_CHECKING:
    from parking_exp.reports.report_data import ReportData
    from parking_exp.reports.sources import ReportSource

Format = Literal["svg", "pdf", "png"]
ALIKE = 0.8  # from how similar on a word is a misspelt key


class ReportOptions(ConfigModel):
    """The `report` group."""

    quick: bool
    formats: list[Format]


class ReportRequest(ConfigModel):
    """The config of scripts/report.py."""

    experiment_name: str | list[str] | None
    source: Annotated[str, Field(min_length=1)] | None = Field(alias="from")
    export: Annotated[str, Field(min_length=1)] | None
    cells: str | list[str] | None
    baseline: str | None
    output_dir: str
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._+-]*$", max_length=200)] | None
    storage: Storage | None
    tracking: StoreConfig
    report: ReportOptions

    @property
    def output_path(self) -> Path:
        """Absolute output directory."""
        return directory_path(self.output_dir)

    @property
    def experiments(self) -> list[str] | None:
        """Names that are typed, None for none."""
        return [self.experiment_name] if isinstance(self.experiment_name, str) else self.experiment_name

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
    typed = {"experiment": request.experiments, "tracking.uri": request.tracking.uri, "export": request.export}
    typed |= {"storage": request.storage}
    if request.source and (beside := [key for key, value in typed.items() if value]):
        raise ConfigError(
            f"{beside[0]}: from={request.source} is all that the report is made of; leave one of them out"
        )
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
    keys = {field.alias or name for name, field in ReportRequest.model_fields.items()}
    known = {*keys, "experiment", *run_keys}
    for key in typed:
        own = key.startswith(("algorithm.", "buffer."))
        if key not in known and not own and (hint := did_you_mean(key, known, cutoff=ALIKE)):
            raise ConfigError(f"{key}: there is no such key{hint}")


def _config_keys() -> Iterator[str]:
    """Yield the dotted keys of the default run."""
    nodes: list[tuple[str, Any]] = [("", composed("config", [])[0])]
    for name, node in nodes:
        yield name
        if isinstance(node, DictConfig):
            nodes += [(f"{name}.{key!s}".removeprefix("."), value) for key, value in node.items()]


def _endings(key: str) -> list[str]:
    parts = key.split(".")
    return [".".join(parts[start:]) for start in range(len(parts))]


def report(config: DictConfig) -> Path:
    """Write a report, print what it says, and return its folder.

    Raises:
        ConfigError: a cell or baseline that there is not.
        ResultsError: the store can't be read, or has no such runs.
        RunNotFoundError: none of the runs is done.
        UntrustedError: a symbolic link leads out of the report's folder.
    """
    request = validate_report(config)
    exported = directory_path(request.export) if request.export else None
    if exported:
        from parking_exp.results.export import refuse_foreign

        refuse_foreign(exported)
    with _progress() as show:
        material = _material(request, show)
        show(f"comparing {plural(len(material.results.runs), 'run')}")
        data = _build(request, material)
        show("drawing")
        from parking_exp.reports.render.files import write  # with matplotlib: not before there is something to draw

        folder = request.output_path / "reports" / (request.name or _folder_name(data.experiments))
        refuse_links([folder.parent, folder], request.output_path)
        refuse_links(folder.rglob("*"), folder)
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder / ".lock"):
            write(data, folder, request.report.formats)
        if exported:
            show("exporting")
            _export(request, material, data, exported)
    _print(data, folder, exported)
    return folder


def _material(request: ReportRequest, show: Callable[[str], None]) -> "ReportSource":
    if request.source is None:
        from parking_exp.reports.sources import from_store

        return from_store(request, show)
    from parking_exp.reports import export

    show("reading the export")
    return export.read(request.source)


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


def _build(request: ReportRequest, material: "ReportSource") -> "ReportData":
    from parking_exp.reports.build import Question, build
    from parking_exp.reports.tuning import with_search, with_tuning

    question = Question(
        experiments=material.experiments,
        cells=request.cells_asked,
        baseline=request.baseline,
        quick=request.report.quick,
        command=_command(request, material.experiments),
    )
    data = build(material.results, question, material.untracked, material.unsynced)
    if request.source is None:
        return with_search(data, request.output_path, request.storage)
    return with_tuning(data, material.tuning) if material.tuning else data


def _export(request: ReportRequest, material: "ReportSource", data: "ReportData", folder: Path) -> None:
    from parking_exp.reports import export

    here = Path().absolute()
    words = [f"from={folder.relative_to(here) if folder.is_relative_to(here) else folder.name}"]
    if data.baseline:
        words.append(f"baseline={data.cell(data.baseline).label}")
    if data.quick:
        words.append("report=quick")
    command = shlex.join(["python", "scripts/report.py", *words])
    export.write(material, data, folder, command, only_cells=bool(request.cells_asked))


def _folder_name(experiments: Sequence[str]) -> str:
    """Return a name that is a folder's and nothing else: in a store, experiments may be called anything."""
    return re.sub(r"[^\w.+-]|^\.", "_", "+".join(experiments))


def _command(request: ReportRequest, experiments: Sequence[str]) -> str:
    """Return the command that makes this report."""
    where = f"from={request.source}" if request.source else f"experiment={','.join(experiments)}"
    words = ["python", "scripts/report.py", where, *request.cells_asked]
    if request.baseline:
        words.append(f"baseline={request.baseline}")
    if request.report.quick:
        words.append("report=quick")
    if request.output_path != Path("outputs").absolute():
        words.append(f"output_dir={request.output_dir}")
    if request.tracking.uri:
        words.append(f"tracking.uri={request.tracking.uri}")
    if request.storage:
        words.append(f"storage={request.storage}")
    if request.name:
        words.append(f"name={request.name}")
    return shlex.join(words)


def _print(data: "ReportData", folder: Path, exported: Path | None) -> None:
    """Say on the terminal what the report says in its first lines."""
    say(*data.claims, *data.missing)
    say(*(f"warning: {sentence}" for sentence in data.warnings), stderr=True)
    if exported:
        say(f"export         {exported}")
    say(f"report         {folder / 'index.html'}")

"""The sections of a report, in order: what each has to say, its figures and its tables."""

import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from pathlib import Path

import matplotlib.figure

from parking_exp.dotted_paths import import_object
from parking_exp.errors import ConfigError
from parking_exp.figure_style import report_style
from parking_exp.phrases import printable_line
from parking_exp.report_section import Section, SectionFigure, Table
from parking_exp.reports.figures.cell_figures import draw_final_success, draw_learning_curves
from parking_exp.reports.figures.comparison_figures import draw_pairs, draw_two_factors
from parking_exp.reports.figures.study_figures import (
    draw_history,
    draw_parameter_importance,
    draw_slices,
)
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.search_report import describe_search, retest_table, trial_table
from parking_exp.reports.tables import report_tables
from parking_exp.reports.tables.table import move_constants_to_caption
from parking_exp.statistics import HOLD
from parking_exp.tasks.registry import task_reports


def describe_provenance(report: ReportData) -> Iterator[str]:
    """Yield when and how runs and report were made."""
    origin = report.provenance
    if origin.first and origin.last:
        yield f"Runs from {origin.first} to {origin.last}."
    yield f"Store: {origin.uri}. Report made {report.made} by parking-exp {report.version}."
    if origin.left_out:
        yield f"Cells of these experiments that were not selected: {'; '.join(origin.left_out)}."


def explain_few_evaluations(report: ReportData) -> Iterator[str]:
    """Yield why there are no curves or times to 90 %, where runs were evaluated too rarely."""
    n_evaluations = []
    for cell in report.cells:
        if cell.curve:
            n_evaluations += [len(steps) for _, steps, _ in cell.curve.seeds]
    reasons = {
        1: "There are no learning curves and times to 90 %: no run was evaluated more than once.",
        2: "There are no times to 90 %: no run was evaluated more than twice.",
    }
    most = max(n_evaluations, default=HOLD)
    if most < HOLD:
        yield f"{reasons[most]} A smaller evaluation.every_n_steps evaluates runs more often."


SECTIONS = (
    Section("retest", "The best on test seeds", tables=[retest_table]),
    Section(
        "tuning",
        "The search",
        text=describe_search,
        figures=[
            SectionFigure("optimisation_history", "Optimisation history", draw_history),
            SectionFigure(
                "parameter_importance", "Importance of parameters", draw_parameter_importance
            ),
            SectionFigure("slices", "Value against each parameter", draw_slices),
        ],
        tables=[trial_table],
    ),
    Section(
        "factors",
        "What each factor does",
        figures=[SectionFigure("two_factors", "Success by two factors", draw_two_factors)],
        tables=[report_tables.factors_table, report_tables.effects_table],
    ),
    Section(
        "results",
        "Which is better",
        figures=[SectionFigure("final_success", "Final success, every seed", draw_final_success)],
        tables=[report_tables.headline_table, report_tables.means_table],
    ),
    Section(
        "curves",
        "Learning curves",
        text=explain_few_evaluations,
        figures=[SectionFigure("learning_curves", "Learning curves", draw_learning_curves)],
        tables=[report_tables.curves_table],
    ),
    Section(
        "time",
        "Time to 90 %",
        tables=[report_tables.times_table],
    ),
    Section(
        "pairs",
        "Pair by pair",
        figures=[SectionFigure("pairwise", "Differences between cells", draw_pairs)],
        tables=[report_tables.pairs_table],
    ),
    Section("seeds", "Every seed", tables=[report_tables.seeds_table]),
    Section(
        "provenance",
        "What was run",
        text=describe_provenance,
        tables=[
            report_tables.versions_table,
            report_tables.config_table,
            report_tables.unfinished_table,
            report_tables.common_table,
        ],
    ),
)


def sections_of(report: ReportData) -> list[Section]:
    """Return SECTIONS, with the sections of the report's tasks before the section `seeds`."""
    sections: list[Section] = []
    for section in SECTIONS:
        if section.id == "seeds":
            for task in task_reports(report.tasks):
                sections += task.sections
        sections.append(section)
    return sections


def load_sections(paths: Sequence[str]) -> list[Section]:
    """Return sections of a user's own package, by their dotted paths.

    Raises:
        ConfigError: there is no such section.
    """
    sections = []
    for path in paths:
        section = import_object(path, f"report.sections: {path}")
        if not isinstance(section, Section):
            raise ConfigError(
                f"report.sections: {path} is not a parking_exp.report_section.Section"
            )
        sections.append(section)
    return sections


@dataclass(frozen=True)
class DrawnFigure:
    """A figure of a report that has been drawn; its caption is plain text, to be escaped."""

    name: str
    title: str
    caption: str
    svg: bytes
    section: str


@dataclass(frozen=True)
class SectionContent:
    """The content of a section, from which the page, LaTeX and CSV are written."""

    id: str
    title: str
    text: Sequence[str]
    tables: Sequence[Table]
    figures: Sequence[DrawnFigure]

    @property
    def is_empty(self) -> bool:
        """Whether the page has nothing of it."""
        return not (self.text or self.figures or self.readable_tables)

    @cached_property
    def readable_tables(self) -> list[Table]:
        """The tables that people read."""
        return [move_constants_to_caption(table) for table in self.tables if table.readable]


def section_contents(
    report: ReportData,
    figures: Sequence[DrawnFigure] = (),
    sections: Sequence[Section] | None = None,
) -> list[SectionContent]:
    """Return what sections say of a report, by default all of them.

    Raises:
        ConfigError: sections, tables or figures have the same name.
    """
    contents = []
    for section in sections_of(report) if sections is None else sections:
        tables: list[Table] = []
        for list_tables in section.tables:
            tables += list_tables(report)
        own_figures = [figure for figure in figures if figure.section == section.id]
        text = list(section.text(report))
        contents.append(SectionContent(section.id, section.title, text, tables, own_figures))
    _refuse_repeats("sections", ["methods", *(content.id for content in contents)])
    _refuse_repeats("tables", [table.name for content in contents for table in content.tables])
    _refuse_repeats("figures", [figure.name for figure in figures])
    return contents


def _refuse_repeats(kind: str, names: Sequence[str]) -> None:
    """Raise ConfigError for repeated names, since files and links are named by them."""
    for name, count in Counter(names).items():
        if count > 1:
            raise ConfigError(f"report.sections: {count} {kind} have the name {name}; rename yours")


def draw_figures(
    report: ReportData,
    folder: Path,
    formats: Sequence[str] = ("svg", "png"),
    sections: Sequence[Section] | None = None,
) -> list[DrawnFigure]:
    """Draw the figures that a report has data for into a folder, as `<name>.<format>`."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn: list[DrawnFigure] = []
    with report_style(), warnings.catch_warnings():
        # A box stands for what the font lacks; browsers have other fonts.
        warnings.filterwarnings("ignore", "Glyph")
        for section in sections_of(report) if sections is None else sections:
            for figure in section.figures:
                drawn += _draw_figure(figure, section.id, report, folder, formats)
    return drawn


def _draw_figure(
    figure: SectionFigure, section: str, report: ReportData, folder: Path, formats: Sequence[str]
) -> Iterator[DrawnFigure]:
    for number, (image, caption) in enumerate(figure.draw(report), start=1):
        name = figure.name if number == 1 else f"{figure.name}_{number}"
        svg = _save(image, folder / name, formats)
        yield DrawnFigure(name, figure.title, printable_line(caption), svg, section)


def _save(figure: matplotlib.figure.Figure, stem: Path, formats: Sequence[str]) -> bytes:
    """Write a figure in some formats, and return it as SVG.

    The same report gives the same bytes: files say neither when nor by what they were made.
    """
    svg = BytesIO()
    figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": None})
    if "svg" in formats:
        Path(f"{stem}.svg").write_bytes(svg.getvalue())
    if "png" in formats:
        figure.savefig(f"{stem}.png", metadata={"Software": None})
    return svg.getvalue()

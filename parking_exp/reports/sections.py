"""The sections of a report, in order: what each has to say, its figures and its tables."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from parking_exp.reports.figures import cells, factors, lot, pairs, search, studies
from parking_exp.reports.figures.canvas import Canvas
from parking_exp.reports.methods import methods
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.tables import report_tables, trial_tables
from parking_exp.reports.tables.table import Table
from parking_exp.reports.tuning_findings import retest_text, search_text

if TYPE_CHECKING:
    from parking_exp.reports.figures.export import Picture

Drawn = tuple[Canvas, str]
"""A figure and its caption."""


@dataclass(frozen=True)
class Figure:
    """A figure of a section.

    Attributes:
        name: stem of its files; `{}` in it becomes the number of each, where `draw` gives several.
        title: a few words.
        draw: data -> the figure and its caption, a list of them, or None without data for it.
    """

    name: str
    title: str
    draw: Callable[[ReportData], Drawn | Sequence[Drawn] | None]


@dataclass(frozen=True)
class Section:
    """A part of the page and of `report.md`. It is left out where it has nothing to say.

    Attributes:
        id: its anchor.
        title: its heading.
        text: data -> paragraphs.
        tables: data -> tables, see `tables.report_tables`.
        figures: in order.
    """

    id: str
    title: str
    text: Callable[[ReportData], Iterable[str]] = lambda report: ()
    tables: Sequence[Callable[[ReportData], Iterable[Table]]] = ()
    figures: Sequence[Figure] = ()


@dataclass(frozen=True)
class SectionContent:
    """What a section says of a report: what the page, Markdown, LaTeX and CSV are written from."""

    id: str
    title: str
    text: Sequence[str]
    tables: Sequence[Table]
    pictures: Sequence["Picture"]

    @property
    def readable_tables(self) -> list[Table]:
        """The tables that people read."""
        return [table for table in self.tables if table.readable]


def section_contents(
    report: ReportData, pictures: Sequence["Picture"] = (), sections: "Sequence[Section] | None" = None
) -> list[SectionContent]:
    """Return what sections say of a report, by default all of them."""
    return [
        SectionContent(
            section.id,
            section.title,
            list(section.text(report)),
            [table for tables in section.tables for table in tables(report)],
            [picture for picture in pictures if picture.section == section.id],
        )
        for section in (SECTIONS if sections is None else sections)
    ]


def what_was_run(report: ReportData) -> Iterable[str]:
    """Yield when and how runs and report were made."""
    origin = report.provenance
    if origin.first and origin.last:
        yield f"Runs from {origin.first} to {origin.last}."
    yield f"Store: {origin.uri}. Report made {report.made} by parking-exp {report.version}."
    if origin.left_out:
        yield f"Cells that were not asked for: {'; '.join(origin.left_out)}."


SECTIONS = (
    Section(
        "retest",
        "The best on fresh seeds",
        text=retest_text,
        tables=[trial_tables.retest],
    ),
    Section(
        "tuning",
        "The search",
        text=search_text,
        figures=[
            Figure("optimisation_history", "Optimisation history", studies.history),
            Figure("pareto_front", "Pareto front", studies.pareto_front),
            Figure("parameter_importance", "Importance of parameters", studies.importance),
            Figure("slices_{}", "Value against each parameter", studies.slices),
            Figure("trial_coordinates", "Trials across their parameters", studies.trial_coordinates),
        ],
        tables=[trial_tables.trials],
    ),
    Section(
        "results",
        "Which is better",
        figures=[Figure("final_success", "Final success, every seed", cells.final_success)],
        tables=[report_tables.headline],
    ),
    Section(
        "curves",
        "Learning curves",
        figures=[Figure("learning_curves", "Learning curves", cells.learning_curves)],
        tables=[report_tables.curves],
    ),
    Section(
        "time",
        "Time to 90 %",
        figures=[Figure("time_to_90", "Time to 90 %", cells.time_to_90)],
        tables=[report_tables.times, report_tables.survival],
    ),
    Section(
        "pairs",
        "Pair by pair",
        text=lambda report: [report.family] if report.pairs else [],
        figures=[Figure("pairwise", "Differences between cells", pairs.pairwise)],
        tables=[report_tables.pairs],
    ),
    Section(
        "factors",
        "What each factor does",
        figures=[
            Figure("main_effects", "Main effects", factors.main_effects),
            Figure("interaction_{}", "Interaction", factors.interactions),
        ],
        tables=[report_tables.effects, report_tables.interactions],
    ),
    Section(
        "scenes",
        "Where episodes fail",
        figures=[Figure("scene_map", "Where on the lot episodes fail", lot.scene_map)],
        tables=[report_tables.slots],
    ),
    Section(
        "trajectories",
        "Seen from above",
        figures=[Figure("trajectories", "Sampled episodes from above", lot.trajectories)],
    ),
    Section(
        "search",
        "Hyperparameters",
        figures=[
            Figure("parallel_coordinates", "What was tried", studies.cell_coordinates),
            Figure("importance", "Which hyperparameters matter", search.importance),
        ],
        tables=[report_tables.importance],
    ),
    Section("seeds", "Every seed", tables=[report_tables.seeds]),
    Section(
        "provenance",
        "What was run",
        text=what_was_run,
        tables=[report_tables.versions, report_tables.config, report_tables.unfinished, report_tables.common],
    ),
    Section("methods", "How it was computed", text=methods),
)

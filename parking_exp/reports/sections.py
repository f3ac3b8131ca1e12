"""The sections of a report, in order: what each has to say, its figures and its tables."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from parking_exp.reports.figures.cell_figures import draw_final_success, draw_learning_curves, draw_time_to_90
from parking_exp.reports.figures.factor_figures import draw_importance, draw_interactions, draw_main_effects
from parking_exp.reports.figures.figure_style import Drawing
from parking_exp.reports.figures.lot_figures import draw_scene_map, draw_trajectories
from parking_exp.reports.figures.pair_figures import draw_pairs
from parking_exp.reports.figures.study_figures import (
    draw_cell_coordinates,
    draw_history,
    draw_parameter_importance,
    draw_pareto_front,
    draw_slices,
    draw_trial_coordinates,
)
from parking_exp.reports.report_data import Cell, ReportData
from parking_exp.reports.tables import cells as cell_tables
from parking_exp.reports.tables import factors as factor_tables
from parking_exp.reports.tables import pairs as pair_tables
from parking_exp.reports.tables import provenance, trial_tables
from parking_exp.reports.tables.model import MakeTables, Table
from parking_exp.reports.tuning_findings import retest_text, search_text


@dataclass(frozen=True)
class Figure:
    """A figure of a section.

    Attributes:
        name: stem of its files; `{}` in it becomes the number of each, where `draw` gives several.
        title: a few words.
        draw: data -> figures and their captions, none without data.
    """

    name: str
    title: str
    draw: Callable[[ReportData], Iterable[Drawing]]


@dataclass(frozen=True)
class Section:
    """A part of the page and of `report.md`. It is left out where it has nothing to say.

    Attributes:
        id: its anchor.
        title: its heading.
        text: data -> paragraphs.
        figures: in order; Markdown has those of all sections together.
        tables: what makes its tables, see `tables`.
        tables_first: whether the page has tables before figures.
        in_markdown: whether its text and tables are in `report.md` too.
    """

    id: str
    title: str
    text: Callable[[ReportData], Sequence[str]] = lambda report: ()
    figures: Sequence[Figure] = ()
    tables: Sequence[MakeTables] = ()
    tables_first: bool = False
    in_markdown: bool = True


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
            Figure("optimisation_history", "Optimisation history", draw_history),
            Figure("pareto_front", "Pareto front", draw_pareto_front),
            Figure("parameter_importance", "Importance of parameters", draw_parameter_importance),
            Figure("slices_{}", "Value against each parameter", draw_slices),
            Figure("trial_coordinates", "Trials across their parameters", draw_trial_coordinates),
        ],
        tables=[trial_tables.trials],
    ),
    Section(
        "results",
        "Which is better",
        figures=[Figure("final_success", "Final success, every seed", draw_final_success)],
        tables=[cell_tables.headline],
        tables_first=True,
    ),
    Section(
        "curves",
        "Learning curves",
        figures=[Figure("learning_curves", "Learning curves", draw_learning_curves)],
        tables=[cell_tables.curves],
    ),
    Section(
        "time",
        "Time to 90 %",
        figures=[Figure("time_to_90", "Time to 90 %", draw_time_to_90)],
        tables=[cell_tables.times, cell_tables.survival],
    ),
    Section(
        "pairs",
        "Pair by pair",
        text=lambda report: [report.family] if report.pairs else [],
        figures=[Figure("pairwise", "Differences between cells", draw_pairs)],
        tables=[pair_tables.pairs],
    ),
    Section(
        "factors",
        "What each factor does",
        figures=[
            Figure("main_effects", "Main effects", draw_main_effects),
            Figure("interaction_{}", "Interaction", draw_interactions),
        ],
        tables=[factor_tables.effects, factor_tables.interactions],
    ),
    Section(
        "scenes",
        "Where episodes fail",
        figures=[Figure("scene_map", "Where on the lot episodes fail", draw_scene_map)],
        tables=[cell_tables.slots],
    ),
    Section(
        "trajectories",
        "Seen from above",
        figures=[Figure("trajectories", "Sampled episodes from above", draw_trajectories)],
    ),
    Section(
        "search",
        "Hyperparameters",
        figures=[
            Figure("parallel_coordinates", "What was tried", draw_cell_coordinates),
            Figure("importance", "Which hyperparameters matter", draw_importance),
        ],
        tables=[factor_tables.importance],
    ),
    Section("seeds", "Every seed", tables=[cell_tables.seeds], in_markdown=False),
)
PROVENANCE = (provenance.config, provenance.common, provenance.versions, provenance.unfinished)
"""The tables of what was run, which page and Markdown arrange themselves."""


def section_tables(section: Section, report: ReportData, cells: Sequence[Cell]) -> list[Table]:
    """Return a section's tables, with rows for these cells."""
    return [table for make in section.tables for table in make(report, cells)]


def provenance_tables(report: ReportData, cells: Sequence[Cell]) -> dict[str, Table]:
    """Return the tables of what was run that have something to read, by name."""
    made = [table for make in PROVENANCE for table in make(report, cells)]
    return {table.name: table for table in made if table.readable}


def report_tables(report: ReportData, cells: Sequence[Cell], sections: Sequence[Section] = SECTIONS) -> list[Table]:
    """Return all tables of a report."""
    made = [table for section in sections for table in section_tables(section, report, cells)]
    return [*made, *(table for make in PROVENANCE for table in make(report, cells))]

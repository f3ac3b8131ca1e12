"""A section of one's own: what `docs/extending.md` shows."""

import csv

from parking_exp.reports.render.files import write_tables
from parking_exp.reports.render.markdown import markdown
from parking_exp.reports.render.page import page
from parking_exp.reports.tables.model import Table, cell_columns, rate, spread
from support import report_factory

from parking_exp.reports.figures.figure_files import draw
from parking_exp.reports.figures.figure_style import new_figure
from parking_exp.reports.sections import SECTIONS, Figure, Section


def timeouts(report, cells):
    """Yield a table with a row for each cell."""
    columns = [*cell_columns(), spread("Timeout (%)", rate, "timeout")]
    yield Table("timeouts", columns, cells, "Episodes that ran out of time.")


def timeout_bars(report):
    """Draw a bar for each cell."""
    figure = new_figure(1.5)
    figure.subplots().bar(range(len(report.cells)), [100 * cell.timeout.value for cell in report.cells])
    yield figure, "Timeouts of each cell, in % of the episodes."


SLOW = Section(
    "slow",
    "Too slow",
    text=lambda report: [f"{len(report.cells)} cells were given 100 steps an episode."],
    figures=[Figure("timeouts", "Timeouts", timeout_bars)],
    tables=[timeouts],
)


def test_a_new_section_is_one_entry_of_the_list(tmp_path):
    report, sections = report_factory.report(2, 3), [*SECTIONS, SLOW]
    (picture,) = draw(report, tmp_path, ["png"], [SLOW])
    html, text = page(report, [picture], sections=sections), markdown(report, [picture], sections=sections)
    assert '<a href="#slow">Too slow</a>' in html
    assert '<figure id="figure-timeouts">' in html
    assert '<table id="table-timeouts">' in html
    assert "<p>2 cells were given 100 steps an episode.</p>" in html
    rows = [
        f"| {cell.label} | {rate(cell.timeout).text} |".replace("[", r"\[").replace("]", r"\]") for cell in report.cells
    ]
    table = "\n".join([r"| Cell | Timeout (%) |", "| :--- | ---: |", *rows])
    assert (
        f"## Too slow\n\n2 cells were given 100 steps an episode.\n\nEpisodes that ran out of time.\n\n{table}\n"
        in text
    )
    assert "![Timeouts](figures/timeouts.png)" in text
    write_tables(report, tmp_path, sections)
    with (tmp_path / "timeouts.csv").open() as file:
        first = next(csv.DictReader(file))
    assert list(first) == ["cell", "label", "timeout", "timeout_low", "timeout_high"]


def test_a_section_without_anything_to_say_is_left_out():
    empty = Section("empty", "Nothing", text=lambda report: [], tables=[lambda report, cells: []])
    report = report_factory.one_seed()
    assert "Nothing" not in page(report, sections=[empty]) + markdown(report, sections=[empty])

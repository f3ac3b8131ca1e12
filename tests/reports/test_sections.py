"""A section of one's own: what `docs/extending.md` shows."""

from dataclasses import replace

import pytest
from support import report_factory

from parking_exp.errors import ConfigError
from parking_exp.figure_style import new_figure
from parking_exp.report_section import Section, SectionFigure, Table, cell_row
from parking_exp.reports.report_files import write_report, write_tables
from parking_exp.reports.report_page import render_page
from parking_exp.reports.sections import (
    draw_figures,
    load_sections,
    section_contents,
    sections_of,
)
from parking_exp.reports.tables import report_tables
from parking_exp.reports.tables.table import cell_column, interval_column, spread


def timeouts(report):
    """Yield a table with a row for each cell."""
    rows = [
        {**cell_row(cell), **spread("timeout", cell.metrics["timeout"])} for cell in report.cells
    ]
    columns = [cell_column(), interval_column("Timeout (%)", "timeout")]
    yield Table("timeouts", rows, columns, "Episodes that ran out of time.")


def timeout_bars(report):
    """Draw a bar for each cell."""
    figure = new_figure(1.5)
    figure.subplots().bar(
        range(len(report.cells)), [100 * cell.metrics["timeout"].value for cell in report.cells]
    )
    yield figure, "Timeouts of each cell, in % of the episodes."


SLOW = Section(
    "slow",
    "Too slow",
    text=lambda report: [f"{len(report.cells)} cells were given 100 steps an episode."],
    figures=[SectionFigure("timeouts", "Timeouts", timeout_bars)],
    tables=[timeouts],
)


def test_a_new_section_is_one_entry_of_the_list(tmp_path):
    report = report_factory.report(2, 3)
    contents = section_contents(
        report, draw_figures(report, tmp_path, ["png"], [SLOW]), [*sections_of(report), SLOW]
    )
    html = render_page(report, contents)
    for part in (
        '<a href="#slow">',
        '<figure id="figure-timeouts">',
        '<table id="table-timeouts">',
        "<p>2 cells were given",
    ):
        assert part in html
    write_tables(contents, tmp_path)
    header, *_ = (tmp_path / "timeouts.csv").read_text().splitlines()
    assert header == "cell,label,timeout,timeout_low,timeout_high"


def test_a_section_of_a_users_package_is_named_in_the_config():
    assert load_sections([f"{__name__}.SLOW"]) == [SLOW]


@pytest.mark.parametrize(
    ("path", "problem"),
    [
        (
            "nothing.here",
            "report.sections: nothing.here: ModuleNotFoundError: No module named 'nothing'",
        ),
        ("json.dumps", "report.sections: json.dumps is not a parking_exp.report_section.Section"),
    ],
)
def test_what_is_no_section_is_refused(path, problem):
    with pytest.raises(ConfigError) as error:
        load_sections([path])
    assert str(error.value) == problem


def test_a_section_without_anything_to_say_is_left_out():
    report = report_factory.one_seed()
    contents = section_contents(
        report, sections=[Section("empty", "Nothing", tables=[lambda report: []])]
    )
    assert "Nothing" not in render_page(report, contents)


@pytest.mark.parametrize(
    ("section", "problem"),
    [
        (replace(SLOW, id="results"), "2 sections have the name results"),
        (
            Section("mine", "Mine", tables=[report_tables.headline_table]),
            "2 tables have the name headline",
        ),
        (
            replace(SLOW, figures=[SectionFigure("pairwise", "Timeouts", timeout_bars)]),
            "2 figures have the name pairwise",
        ),
    ],
)
def test_a_section_that_would_replace_parts_of_others_is_refused(section, problem, tmp_path):
    report = report_factory.report(2, 3)
    with pytest.raises(ConfigError) as error:
        write_report(report, tmp_path, ["svg"], [section])
    assert str(error.value) == f"report.sections: {problem}; rename yours"
    assert not [*tmp_path.iterdir()]


def test_methods_are_those_of_the_numbers_that_the_report_has():
    report = report_factory.report(2, 10)
    untrained = replace(report, cells=[replace(cell, total_timesteps=0) for cell in report.cells])
    alone = replace(report, pairs=[], cells=[replace(cell, n_timed=0) for cell in report.cells])
    pages = [
        render_page(each, ()).partition('id="methods"')[2] for each in (report, untrained, alone)
    ]
    assert ["if none of 10 seeds collapses, up to 26 %" in page for page in pages] == [True] * 3
    assert ["What is not trained" in page for page in pages] == [False, True, False]
    assert ["A verdict needs 4 seeds" in page for page in pages] == [True, True, False]
    assert ["Time to 90 %" in page for page in pages] == [True, True, False]
    assert not any("A main effect" in page for page in pages)

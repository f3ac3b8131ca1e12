"""The figures of a report: which there are, that they show the report's values, and that no name
can do harm.
"""

import re
import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from PIL import Image
from support import report_factory

from parking_exp.figure_style import cell_style, report_style, wrapped_labels
from parking_exp.reports.figures import cell_figures, comparison_figures
from parking_exp.reports.sections import SECTIONS, draw_figures
from parking_exp.reports.tables import report_tables
from parking_exp.tasks.parking import lot_figures

SVG = "{http://www.w3.org/2000/svg}"
LIST = ["final_success", "learning_curves", "pairwise", "scene_map"]


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.fixture(scope="module")
def three():
    """A report on three cells of ten seeds."""
    return report_factory.report(3, 10)


@pytest.fixture(scope="module")
def drawn(three, tmp_path_factory):
    """The folder of its figures' files, and the figures by name."""
    folder = tmp_path_factory.mktemp("three") / "figures"
    return folder, {figure.name: figure for figure in draw_figures(three, folder)}


def axes_of(draw_figure, report):
    """The axes of the first figure that a function draws."""
    with report_style():
        figure, _ = next(iter(draw_figure(report)))
    return figure.axes


def lines(axes, cell):
    """The lines in a cell's colour."""
    return [line for line in axes.lines if line.get_color() == cell_style(cell).colour]


def texts(artists):
    return [text.get_text() for text in artists]


def sections(*ids):
    """Some sections: to draw all of a report takes seconds."""
    return [section for section in SECTIONS if section.id in ids]


def test_every_figure_is_written_in_every_format(drawn):
    folder, figures = drawn
    assert list(figures) == LIST
    assert {path.name for path in folder.iterdir()} == {
        f"{n}.{kind}" for n in LIST for kind in ("svg", "png")
    }
    for name in LIST:
        assert ET.fromstring((folder / f"{name}.svg").read_bytes()).tag == f"{SVG}svg"
        assert figures[name].svg == (folder / f"{name}.svg").read_bytes()
        with Image.open(folder / f"{name}.png") as image:
            assert image.width == 6.8 * 200
    assert "10 seeds per cell" in figures["final_success"].caption


@pytest.mark.slow
def test_the_same_report_gives_the_same_bytes_whatever_the_users_settings(three, drawn, tmp_path):
    with matplotlib.rc_context({"font.size": 20, "lines.linewidth": 9, "axes.facecolor": "red"}):
        before = dict(matplotlib.rcParams)
        draw_figures(three, tmp_path)
        assert dict(matplotlib.rcParams) == before
    for path in drawn[0].iterdir():
        assert path.read_bytes() == (tmp_path / path.name).read_bytes(), path.name


def test_final_success_has_every_seed_and_the_mean_with_its_interval(three):
    (axes,) = axes_of(cell_figures.draw_final_success, three)
    assert texts(axes.get_yticklabels()) == ["sac", "td3", "ddpg"]
    for row, cell in enumerate(three.cells):
        seeds, interval, mean = lines(axes, cell.id)
        assert seeds.get_xdata() == pytest.approx([100 * seed.success for seed in cell.seeds])
        assert np.abs(seeds.get_ydata() - row).max() < 0.5
        assert interval.get_xdata() == pytest.approx(
            [100 * cell.success.low, min(100, 100 * cell.success.high)]
        )
        assert mean.get_xdata() == pytest.approx([100 * cell.success.value])
    (axes,) = axes_of(cell_figures.draw_final_success, replace(three, shown=["c2"]))
    assert len(lines(axes, "c2")) == 3  # a cell keeps its colour


def test_learning_curves_have_means_and_every_seed(three):
    success, crash = axes_of(cell_figures.draw_learning_curves, three)
    for cell in three.cells:
        *seeds, mean = lines(success, cell.id)
        assert len(seeds) == 10
        assert mean.get_xdata() == pytest.approx(cell.curve.step)
        assert mean.get_ydata() == pytest.approx(100 * np.array(cell.curve.mean))
        (crashes,) = lines(crash, cell.id)
        assert crashes.get_ydata() == pytest.approx(100 * np.array(cell.curve.failure))
    (legend,) = success.figure.legends
    assert texts(legend.texts) == ["sac", "td3", "ddpg"]


def test_pairs_are_differences_between_all_cells_or_from_the_baseline(three):
    (axes,) = axes_of(comparison_figures.draw_pairs, three)
    assert texts(axes.get_yticklabels()) == ["sac\n− td3", "sac\n− ddpg", "td3\n− ddpg"]  # noqa: RUF001
    assert three.pairs[1].verdict == "a"
    assert "▲" in axes.texts[1].get_text()
    _, _, ddpg = axes.lines[1:][1::2]
    assert ddpg.get_xdata() == pytest.approx([100 * three.pairs[2].difference.value])
    long = replace(three, pairs=[three.pairs[0]] * 60, declared=True)
    pages = [*comparison_figures.draw_pairs(long)]
    assert [len(figure.axes[0].texts) for figure, _ in pages] == [24, 24, 12]
    assert [caption for _, caption in pages[1:]] == ["Continued."] * 2
    against = replace(three, baseline="c2", reference="c2", pairs=three.pairs[1:])
    (axes,) = axes_of(comparison_figures.draw_pairs, against)
    assert texts(axes.get_yticklabels()) == ["sac", "td3"]


def test_pairs_that_nobody_has_chosen_are_drawn_only_if_they_are_few():
    eight = report_factory.report(8, 2)
    assert len(eight.pairs) == 28
    assert [*comparison_figures.draw_pairs(eight)] == []
    (table,) = report_tables.pairs_table(eight)
    assert (len(table.rows), table.folded) == (28, True)
    assert len([*comparison_figures.draw_pairs(report_factory.report(7, 2))]) == 1


def test_two_crossed_factors_are_a_map_of_mean_success():
    report = report_factory.her_ablation(3)
    axes, _ = axes_of(comparison_figures.draw_two_factors, report)
    rates = {cell.label: f"{100 * cell.success.value:.1f}" for cell in report.cells}
    assert texts(axes.texts) == [*rates.values()]
    assert texts(axes.get_xticklabels())[3] == "8"
    assert texts(axes.get_yticklabels())[0] == "her_future"


def test_the_map_has_failures_by_slot(three):
    slots = [
        {"slot": slot, "crash": 0.01 * slot, "timeout": 0.02} for slot in range(28) if slot != 5
    ]
    cell = replace(three.cells[0], task_data={"slots": slots})
    axes, *_ = axes_of(lot_figures.draw_scene_map, replace(three, cells=[cell]))
    shown = axes.collections[2].get_array().filled(np.nan)
    assert np.isnan(shown[5])
    assert np.delete(shown, 5) == pytest.approx([slot + 2 for slot in range(28) if slot != 5])
    assert texts(axes.texts) == [str(slot + 2) for slot in range(28) if slot != 5]


def test_paths_are_in_the_colour_of_their_outcome_with_the_car_at_the_end_and_crashes_on_top(three):
    paths = pd.DataFrame(
        [
            (0, 0, 0.0, 0.0, 0.0, "crash"),
            (0, 1, 3.0, 4.0, 0.0, "crash"),
            (1, 0, 0.0, 0.0, 0.0, "success"),
            (1, 1, 1.0, 0.0, 0.0, "success"),
            (1, 2, 2.0, 14.0, np.pi / 2, "success"),
        ],
        columns=["scene", "step", "x_m", "y_m", "heading_rad", "outcome"],
    )
    without, cell = three.cells[:2]
    driven = replace(cell, figure_data=replace(cell.figure_data, paths=paths))
    (axes,) = axes_of(lot_figures.draw_paths, replace(three, cells=[without, driven]))
    assert axes.get_title(loc="left") == "td3"

    _, _, success, parked, timeout, _, crash, crashed = axes.collections
    assert [path.vertices.tolist() for path in success.get_paths()] == [[[0, 0], [1, 0], [2, 14]]]
    assert [path.vertices.tolist() for path in crash.get_paths()] == [[[0, 0], [3, 4]]]
    assert timeout.get_paths() == []
    corners = [[4.5, 1], [4.5, -1], [-0.5, -1], [-0.5, 1]]
    assert sorted(crashed.get_paths()[0].vertices[:4].tolist()) == sorted(
        [x + 1, y + 4] for x, y in corners
    )
    parked_x = parked.get_paths()[0].vertices[:4, 0]
    assert sorted(parked_x) == pytest.approx([1, 1, 3, 3])
    assert to_hex(success.get_colors()[0]) == "#009e73"
    assert to_hex(crash.get_colors()[0]) == to_hex(crashed.get_edgecolors()[0]) == "#d55e00"


def test_a_lot_without_walls_has_none_in_figures(three):
    cell = three.cells[0]
    open_lot = replace(cell, figure_data=replace(cell.figure_data, walls=False))
    _, (walled, not_walled) = lot_figures.draw_lots([cell, open_lot])
    assert len(walled.collections) - len(not_walled.collections) == 1


@pytest.mark.parametrize(
    "example",
    [
        report_factory.one_seed,
        report_factory.all_succeed,
        report_factory.with_failed_cell,
        pytest.param(lambda: report_factory.report(60, 2), marks=pytest.mark.slow),
    ],
    ids=["one seed", "all succeed", "failed cell", "many cells"],
)
def test_unusual_contents_are_drawn_without_a_warning(example, tmp_path):
    wanted = sections("results", "curves", "time", "pairs")
    assert draw_figures(example(), tmp_path, [], wanted)[0].name == "final_success"


def test_nothing_to_draw_gives_no_figure(tmp_path):
    failed = report_factory.with_failed_cell().cells[2]
    empty = replace(report_factory.report(1, 1), cells=[failed], shown=[failed.id], pairs=())
    assert draw_figures(empty, tmp_path) == []
    assert draw_figures(replace(empty, cells=[], shown=[]), tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_labels_are_written_as_they_are_and_do_nothing(tmp_path):
    hostile = "a\x00b\x1b[31m\u202eevil \ud800 <script>alert(1)</script>"
    labels = [r"$\frac{x}{0} a_b^c \n", "Größe α 学習", hostile, *report_factory.HOSTILE[1:3]]  # noqa: RUF001
    (figure,) = draw_figures(
        report_factory.report(5, 2, labels=labels), tmp_path, ["png"], sections("results")
    )
    elements = [*ET.fromstring(figure.svg).iter()]
    written = {element.text for element in elements}
    assert {*labels[:2], "ab[31mevil <script>alert(1)</script>"} <= written
    tags = {element.tag.removeprefix(SVG) for element in elements}
    assert not tags & {"script", "img", "b", "a", "foreignObject"}
    for element in elements:
        for key, value in element.attrib.items():
            assert not key.startswith("on")
            assert not key.endswith("href") or value.startswith(("#", "data:image/"))
    assert not re.search(rb"url\((?!#)", figure.svg)


def test_long_labels_are_wrapped_and_cut():
    labels = ["her_future, n_sampled_goal=1", "replay", "her_future, n_sampled_goal=1, gamma=0.9"]
    cells = report_factory.report(3, 1, labels=labels).cells
    two_lines = "her_future,\nn_sampled_goal=1"
    assert wrapped_labels(cells, 18, lines=2) == [two_lines, "replay", f"{two_lines},…"]

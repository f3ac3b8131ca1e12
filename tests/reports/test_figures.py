"""Pictures of a report: which there are, what they show, and that nothing in a name can do harm."""

import re
import subprocess
import sys
import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from PIL import Image
from support import report_factory

from parking_exp.reports import formats
from parking_exp.reports.figures import cells, style
from parking_exp.reports.figures.export import draw
from parking_exp.reports.figures.studies import cell_coordinates
from parking_exp.reports.report_data import Interval
from parking_exp.reports.sections import SECTIONS

SVG = "{http://www.w3.org/2000/svg}"
LIST = ["final_success", "learning_curves", "time_to_90", "pairwise", "scene_map", "trajectories"]


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def tips(picture):
    return [e.get("data-tip") for e in ET.fromstring(picture.svg).iter() if e.get("data-tip") is not None]


def sections(*ids):
    """Some sections: to draw all of a report takes a second or more."""
    return [section for section in SECTIONS if section.id in ids]


def by_name(pictures):
    return {picture.name: picture for picture in pictures}


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Three cells of ten seeds: report, folder, pictures by name."""
    report, folder = report_factory.report(3, 10), tmp_path_factory.mktemp("three") / "figures"
    return report, folder, by_name(draw(report, folder))


@pytest.fixture(scope="module")
def ablation(tmp_path_factory):
    """Pictures of two crossed factors, by name."""
    return by_name(draw(report_factory.her_ablation(3), tmp_path_factory.mktemp("ablation"), []))


@pytest.fixture(scope="module")
def search(tmp_path_factory):
    """Pictures of a search, by name."""
    return by_name(draw(report_factory.search(5), tmp_path_factory.mktemp("search"), []))


def test_every_picture_is_written_in_every_format(three):
    _, folder, pictures = three
    assert list(pictures) == LIST
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        f"{name}.{kind}" for name in LIST for kind in ("svg", "pdf", "png")
    )
    for name in LIST:
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert ET.fromstring((folder / f"{name}.svg").read_bytes()).tag == f"{SVG}svg"
        with Image.open(folder / f"{name}.png") as image:
            assert image.width <= 6.8 * 200 + 1


@pytest.mark.slow
def test_factors_and_searches_have_pictures_of_their_own(ablation, search):
    assert list(ablation) == [*LIST[:4], "main_effects", "interaction_1", *LIST[4:]]
    assert list(search) == [*LIST, "parallel_coordinates", "importance"]


def test_a_sweep_in_which_a_cell_lacks_a_numeric_key_is_drawn():
    report = report_factory.search(5)
    first = replace(report.cells[0], settings={**report.cells[0].settings, "algorithm.batch_size": None})
    canvas, caption = cell_coordinates(replace(report, cells=[first, *report.cells[1:]]))
    assert caption.startswith("Each cell as a line")
    assert canvas.figure.axes


def test_without_formats_nothing_is_written(tmp_path):
    assert draw(report_factory.one_seed(), tmp_path, [], sections("results"))
    assert list(tmp_path.iterdir()) == []


def test_text_in_pdfs_stays_text_in_truetype_fonts(three):
    pdf = (three[1] / "final_success.pdf").read_bytes()
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf


@pytest.mark.slow
def test_same_content_gives_same_bytes(three, tmp_path):
    report, folder, pictures = three
    again = by_name(draw(report, tmp_path))
    assert again == pictures
    for path in folder.iterdir():
        assert path.read_bytes() == (tmp_path / path.name).read_bytes(), path.name


def test_users_settings_neither_change_pictures_nor_are_changed(three, tmp_path):
    with matplotlib.rc_context({"font.size": 20, "lines.linewidth": 9, "axes.facecolor": "red"}):
        before = dict(matplotlib.rcParams)
        drawn = by_name(draw(three[0], tmp_path, []))
        assert dict(matplotlib.rcParams) == before
    assert drawn == three[2]


@pytest.mark.slow
def test_drawing_imports_neither_pyplot_nor_torch(tmp_path):
    code = (
        "import sys; sys.path.insert(0, 'tests'); from support import report_factory; from pathlib import Path;"
        "from parking_exp.reports.figures.export import draw; draw(report_factory.one_seed(), Path(sys.argv[1]));"
        "print(sorted({'matplotlib.pyplot', 'torch'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True, capture_output=True, text=True)
    assert done.stdout == "[]\n"


def test_a_cell_keeps_its_colour_in_every_picture_and_selection(three):
    report, _, pictures = three
    for cell, colour in zip(report.cells, ("#0072b2", "#d55e00", "#009e73"), strict=True):
        assert style.cell_style(cell.id).colour.lower() == colour
        for name in LIST[:3]:
            assert colour in pictures[name].svg
    few = replace(report, shown=["c2"])
    canvas, _ = cells.final_success(few)
    assert {line.get_color() for line in canvas.figure.axes[0].lines} == {"#009E73", style.INK}


def test_no_two_of_forty_cells_look_the_same():
    looks = [style.cell_style(f"c{n}") for n in range(40)]
    assert len({(look.colour, look.marker) for look in looks}) == 40
    assert not {"#000000", "#F0E442"} & {look.colour for look in looks}


def test_values_under_the_pointer_are_the_contents_own(three):
    report, _, pictures = three
    cell = report.cells[0]
    seed = cell.seeds[3]
    rate = f"{100 * seed.success:.1f}"
    text = f"sac, seed 3: {rate} % [{100 * seed.low:.0f}, {100 * seed.high:.0f}]"
    assert text in tips(pictures["final_success"])
    mean = f"sac: mean {formats.rate_interval(cell.success)}, 10 seeds"
    assert mean in tips(pictures["final_success"])
    step, rate = cell.curve.step[4], cell.curve.mean[4]
    assert any(
        t.startswith(f"sac, {step:,} env steps: {formats.rate_text(rate)} [") for t in tips(pictures["learning_curves"])
    )
    slot = cell.slots[5]
    failed = formats.rate_text(slot.crash + slot.timeout)
    assert any(t.startswith(f"sac, slot 5: {failed} failed (") for t in tips(pictures["scene_map"]))
    path = cell.paths[2]
    assert f"sac, seed 2, scene 1002: crash after 17 steps, slot {path.slot}" in tips(pictures["trajectories"])


@pytest.mark.parametrize(("value", "text"), [(0.92, "92.0 %"), (0.986, "98.6 %"), (1.0, "100.0 %"), (None, "unknown")])
def test_shares_are_written_as_percentages(value, text):
    assert formats.rate_text(value) == text


def test_every_seed_point_lies_under_its_value(three):
    report, _, pictures = three
    seeds = [seed for cell in report.cells for seed in cell.seeds]
    circles = [
        e for e in ET.fromstring(pictures["final_success"].svg).iter(f"{SVG}circle") if "seed " in e.get("data-tip")
    ]
    assert len(circles) == len(seeds)
    rates, xs = [seed.success for seed in seeds], [float(circle.get("cx")) for circle in circles]
    slope, start = np.polyfit(rates, xs, 1)
    assert slope > 0
    assert np.abs(np.array(xs) - slope * np.array(rates) - start).max() < 0.1


def test_a_pair_reads_the_same_both_ways_round(three):
    report, _, pictures = three
    pair = report.pairs[1]
    assert (pair.a, pair.b, pair.verdict) == ("c0", "c2", "a")
    value, low, high = (formats.points(v) for v in (pair.difference.value, pair.difference.low, pair.difference.high))
    found = tips(pictures["pairwise"])
    assert any(t.startswith(f"sac minus ddpg: {value} [{low}, {high}] points") for t in found)
    value, low, high = (formats.points(-v) for v in (pair.difference.value, pair.difference.high, pair.difference.low))
    turned = next(t for t in found if t.startswith("ddpg minus sac"))
    assert turned.startswith(f"ddpg minus sac: {value} [{low}, {high}] points")
    assert turned.endswith("; sac is better")


def test_with_a_baseline_differences_are_from_it(three, tmp_path):
    report = replace(three[0], baseline="c1", reference="c1")
    picture = by_name(draw(report, tmp_path, [], sections("pairs")))["pairwise"]
    assert "baseline, td3," in picture.caption
    assert [t.partition(":")[0] for t in tips(picture) if " minus " in t] == ["sac minus td3", "ddpg minus td3"]


def test_real_share_stands_in_each_place_and_gaps_stay_empty(tmp_path):
    report = report_factory.her_ablation(3)
    table = report.interactions[0]
    mean = [list(row) for row in table.mean]
    mean[0][0] = None
    report = replace(report, interactions=[replace(table, mean=mean, given="env=parking_sparse")])
    picture = by_name(draw(report, tmp_path, [], sections("factors")))["interaction_1"]
    texts = [e.text for e in ET.fromstring(picture.svg).iter(f"{SVG}text")]
    real = [text for text in texts if text.endswith(" % real")]
    assert real[:6] == ["33 % real", "20 % real", "11 % real", "6 % real", "67 % real", "50 % real"]
    assert "env=parking_sparse" in texts
    assert "her_future × 1: no finished runs" in tips(picture)  # noqa: RUF001
    assert "for env=parking_sparse" in picture.caption


@pytest.mark.parametrize(
    "report",
    [
        report_factory.one_seed(),
        report_factory.all_succeed(),
        report_factory.with_failed_cell(),
        report_factory.non_ascii(),
        report_factory.many(60, 2),
    ],
    ids=["one seed", "all succeed", "failed cell", "non-ascii", "many cells"],
)
def test_unusual_contents_are_drawn_without_a_warning(report, tmp_path):
    pictures = draw(report, tmp_path, ["png"])
    assert pictures[0].name == "final_success"
    for picture in pictures:
        ET.fromstring(picture.svg)


def test_a_cell_without_results_has_a_row_that_says_so(tmp_path):
    picture = by_name(draw(report_factory.with_failed_cell(), tmp_path, [], sections("results")))["final_success"]
    assert "no finished seeds" in picture.svg


def test_nothing_to_draw_gives_no_picture(tmp_path):
    failed = report_factory.with_failed_cell().cells[2]
    empty = replace(report_factory.report(1, 1), cells=[failed], shown=[failed.id], pairs=())
    assert draw(empty, tmp_path) == []
    assert draw(replace(empty, cells=[], shown=[]), tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_unknown_numbers_leave_gaps(tmp_path):
    report = report_factory.report(2, 4)
    cell = report.cells[0]
    curve = replace(cell.curve, mean=[None, *cell.curve.mean[1:]], low=[None] * 20, high=[None] * 20, crash=[None] * 20)
    seeds = [replace(cell.seeds[0], success=None, low=None, high=None), *cell.seeds[1:]]
    slots = [replace(cell.slots[0], n=0, success=None, crash=None, timeout=None), *cell.slots[1:]]
    cell = replace(cell, curve=curve, seeds=seeds, slots=slots, success=Interval(None), survival=None)
    few = sections("results", "curves", "scenes")
    pictures = by_name(draw(replace(report, cells=[cell, report.cells[1]]), tmp_path, [], few))
    assert len([t for t in tips(pictures["final_success"]) if "sac, seed" in t]) == 3
    assert not any(t.startswith("sac, 2,000 env steps") for t in tips(pictures["learning_curves"]))
    assert "sac, slot 0: no episodes" in tips(pictures["scene_map"])


@pytest.mark.slow
def test_hostile_names_are_shown_and_do_nothing(tmp_path):
    report = report_factory.hostile()
    nasty = "a\x00b\x1b[31m\u202eevil \ud800 <script>alert(1)</script>"
    report = replace(report, cells=[replace(report.cells[0], label=nasty), *report.cells[1:]])
    pictures = draw(report, tmp_path)
    for picture in pictures:
        for text in (picture.svg, (tmp_path / f"{picture.name}.svg").read_text()):
            root = ET.fromstring(re.sub(r"<!DOCTYPE.*?>", "", text, flags=re.S))
            assert not {e.tag.removeprefix(SVG) for e in root.iter()} & {
                "script",
                "img",
                "b",
                "a",
                "foreignObject",
                "image",
            }
            for element in root.iter():
                assert not [key for key in element.attrib if key.startswith("on")]
                assert not [v for k, v in element.attrib.items() if k.endswith("href") and not v.startswith("#")]
    assert any(t.startswith("ab[31mevil <script>alert(1)</script>, seed 0: ") for t in tips(pictures[0]))
    assert any(t.startswith("100% & $x_1$ # {a} ~ ^ \\input{x} \\, seed") for t in tips(pictures[0]))
    for picture in pictures:
        assert "<script" not in picture.svg
        assert not re.search(r"url\((?!#)", picture.svg)


def test_mathematics_in_labels_is_written_as_it_is(tmp_path):
    report = report_factory.report(1, 2, labels=[r"$\frac{x}{0} a_b^c \n"])
    picture = draw(report, tmp_path, ["png", "pdf"], sections("results"))[0]
    assert r"$\frac{x}{0} a_b^c \n" in [e.text for e in ET.fromstring(picture.svg).iter(f"{SVG}text")]


def test_pages_show_characters_that_the_drawings_font_lacks(tmp_path):
    picture = draw(report_factory.non_ascii(), tmp_path, ["svg"], sections("results"))[0]
    texts = [e.text for e in ET.fromstring(picture.svg).iter(f"{SVG}text")]
    assert "Größe α 学習" in texts  # noqa: RUF001
    assert "Größe α □□" in (tmp_path / "final_success.svg").read_text()  # noqa: RUF001


def test_long_labels_are_shortened_in_the_middle_and_stay_different():
    cells = report_factory.report(3, 1, labels=["same " + "x" * 300 + end for end in ("one", "two", "two")]).cells
    short = style.labels(cells, 100)
    assert len(set(short.values())) == 3
    assert short["c0"].startswith("same x") and short["c0"].endswith("xone") and "…" in short["c0"]
    assert short["c2"].endswith(" (c2)")
    assert all(style.width_pt(text) <= 100 for text in short.values())


def test_ids_and_references_belong_to_one_picture(ablation, search):
    seen = set()
    for picture in [*ablation.values(), search["parallel_coordinates"], search["importance"]]:
        ids = re.findall(r'\bid="([^"]+)"', picture.svg)
        references = re.findall(r'href="#([^"]+)"', picture.svg) + re.findall(r"url\(#([^)]+)\)", picture.svg)
        assert all(identity.startswith(f"{picture.name}-") for identity in ids)
        assert set(references) == set(ids)
        assert len(ids) == len(set(ids)) and not seen & set(ids)
        seen |= set(ids)


def test_page_drawings_follow_the_pages_theme(three):
    for picture in three[2].values():
        root = ET.fromstring(picture.svg)
        assert root.get("role") == "img" and root.get("aria-label") == picture.title
        assert "width" in root.attrib and "height" not in root.attrib and "viewBox" in root.attrib
        assert "var(--ink" in picture.svg
        assert not any(colour in picture.svg for colour in (style.INK, "<?xml", "<metadata", "<style"))
        assert "font-family: inherit" in picture.svg and "DejaVu" not in picture.svg


def test_captions_are_one_line_and_say_what_bars_are(three):
    for picture in three[2].values():
        assert picture.caption == " ".join(picture.caption.split())
    assert "mean with its 95 % interval" in three[2]["final_success"].caption
    assert "10 seeds per cell" in three[2]["final_success"].caption

"""The report's page in a real browser, from a file, with the network watched."""

import pytest
from support import report_factory
from support.marks import slow_but

from parking_exp.reports.report_page import render_page
from parking_exp.reports.sections import DrawnFigure, section_contents

SECTIONS = {
    "final_success": "results",
    "learning_curves": "curves",
    "pairwise": "pairs",
    "scene_map": "scenes",
}
SVG = (
    b'<svg xmlns="http://www.w3.org/2000/svg" width="490" height="200">'
    b'<circle cx="90" cy="80" r="20"/></svg>'
)
FIGURES = [
    DrawnFigure(name, name.replace("_", " ").capitalize(), "Each point is a seed.", SVG, section)
    for name, section in SECTIONS.items()
]


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    """The page of an example as a file; written once."""
    folder = tmp_path_factory.mktemp("pages")

    def written(name):
        path = folder / f"{name}.html"
        if not path.exists():
            report = getattr(report_factory, name)()
            path.write_text(
                render_page(report, section_contents(report, FIGURES)), encoding="utf-8"
            )
        return path

    return written


@pytest.fixture
def show(open_page, files):
    """Open an example's page."""
    return lambda name, width=1280, **options: open_page(files(name), width, **options)


def labels_in(tab):
    """Labels of the visible rows of the headline's table, in their order."""
    rows = tab.locator("#table-headline tbody tr")
    return rows.evaluate_all(
        "rows => rows.filter(row => !row.hidden).map(row => row.cells[0].innerText.trim())"
    )


@pytest.mark.parametrize(
    "name", slow_but(["her_ablation"], ["all_succeed", "with_failed_cell", "her_ablation"])
)
def test_page_is_no_wider_than_the_window(show, name):
    report = getattr(report_factory, name)()
    tab = show(name, 360)
    assert tab.locator("h1").inner_text() == report.title
    assert tab.locator("#table-headline tbody tr").count() == len(report.cells)
    assert tab.evaluate("document.scrollingElement.scrollWidth") <= 360
    tab.set_viewport_size({"width": 1280, "height": 900})
    assert tab.evaluate("document.scrollingElement.scrollWidth") <= 1280


def test_success_sorts_best_first_then_worst_first_and_missing_last(show):
    tab = show("with_failed_cell")
    success = tab.locator("#table-headline thead th", has_text="Success").first
    for order, labels in (
        ("descending", ["sac", "td3", "ddpg"]),
        ("ascending", ["td3", "sac", "ddpg"]),
    ):
        success.locator("button").click()
        assert success.get_attribute("aria-sort") == order
        assert labels_in(tab) == labels


def test_the_keyboard_sorts_text_by_the_numbers_in_it_and_a_filter_leaves_rows_with_all_words(show):
    tab = show("her_ablation")
    tab.locator("#table-headline thead th", has_text="Cell").first.locator("button").press("Enter")
    assert labels_in(tab)[:5] == [f"her_episode, n_sampled_goal={n}" for n in (1, 2, 4, 8, 16)]
    table = tab.locator(".table", has=tab.locator("#table-headline"))
    table.locator("input").fill("FINAL goal=4")
    assert labels_in(tab) == ["her_final, n_sampled_goal=4"]
    assert table.locator("output").inner_text() == "1 of 20"


def test_hostile_names_are_text(show):
    tab = show("hostile", 360)
    assert tab.evaluate("window.pwned") is None
    assert tab.locator("h1").inner_text() == report_factory.HOSTILE[0]
    assert tab.title().startswith(report_factory.HOSTILE[0])
    names = tab.locator("#table-headline tbody th bdi").all_text_contents()
    assert names == list(report_factory.HOSTILE)
    assert tab.locator("img:not(figure img)").count() == 0
    assert tab.locator("script").count() == 1
    assert tab.evaluate("document.scrollingElement.scrollWidth") <= 360


def test_an_injected_inline_script_does_not_run(browser, files):
    tab = browser.new_page()
    tab.goto(files("report").as_uri())
    tab.evaluate(
        "document.body.append("
        "Object.assign(document.createElement('script'), {text: 'window.pwned = 1'}))"
    )
    assert tab.evaluate("window.pwned") is None
    tab.close()


@pytest.mark.parametrize("name", ["her_ablation", "hostile"])
def test_print_fits_the_page_and_the_head_of_a_table_can_be_repeated(show, name):
    tab = show(name, 688)  # the width of A4 between its margins
    tab.locator("details").evaluate_all("all => all.forEach(details => details.open = true)")
    tab.emulate_media(media="print")
    assert tab.evaluate("document.scrollingElement.scrollWidth") <= 688
    buttons = tab.locator("thead button").evaluate_all(
        "all => all.map(button => getComputedStyle(button).display)"
    )
    assert {*buttons} == {"contents"}


def test_a_small_screen_shows_a_figure_whole_and_enlarges_it_on_request(show):
    figure = show("report", 420).locator("#figure-pairwise .picture")
    hidden = "picture => picture.scrollWidth - picture.clientWidth"
    assert figure.evaluate(hidden) == 0
    figure.click()
    assert figure.evaluate(hidden) > 200


def background(tab):
    return tab.evaluate("getComputedStyle(document.body).backgroundColor")


def test_the_theme_can_be_changed_and_is_remembered_and_print_is_light_without_controls(show):
    tab = show("report", color_scheme="light")
    light = background(tab)
    tab.locator("#theme").click()
    dark = background(tab)
    assert sum(map(int, dark[4:-1].split(","))) < 3 * 64
    # Beside other load, Chromium may hand what a page has stored to the next process after the
    # reload, or not at all.
    stored = tab.evaluate("JSON.stringify(localStorage)")
    tab.add_init_script(f"Object.assign(localStorage, {stored})")
    tab.reload()
    assert background(tab) == dark != light
    tab.emulate_media(media="print", color_scheme="dark")
    assert background(tab) == "rgb(255, 255, 255)"
    for selector in ("#theme", ".filter", "nav"):
        assert tab.locator(selector).first.is_hidden()


def test_the_page_is_complete_without_javascript(show):
    tab = show("her_ablation", java_script_enabled=False)
    assert tab.locator("#table-headline tbody tr").count() == 20
    assert tab.locator("#theme").count() == 0
    widths = tab.locator("figure img").evaluate_all(
        "images => images.map(image => image.naturalWidth)"
    )
    assert widths == [490] * len(FIGURES)
    assert (
        tab.locator("#figure-pairwise img").get_attribute("alt")
        == "Pairwise. Each point is a seed."
    )
    tab.locator("#seeds summary").click()
    assert tab.locator("#table-seeds").is_visible()
    assert tab.locator("#tuning, #table-unfinished").count() == 0  # sections without data
    ids = tab.locator("[id]").evaluate_all("elements => elements.map(element => element.id)")
    assert len(ids) == len(set(ids))
    targets = tab.locator("nav a").evaluate_all("links => links.map(link => link.hash.slice(1))")
    assert {*targets} <= {*ids}

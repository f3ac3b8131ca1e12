"""The page of reference results, and README's rates, are what the exports beside them give."""

import importlib.util
import shutil

import pytest
from support.runs import ROOT, read_text

EXPORTS = ROOT / "docs" / "results"
MOST_BYTES = 2_000_000


@pytest.fixture
def page(tmp_path, monkeypatch):
    """The script, on a copy of what it reads and writes."""
    spec = importlib.util.spec_from_file_location("results_page", ROOT / "scripts" / "results_page.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    shutil.copytree(EXPORTS, tmp_path / "docs" / "results")
    shutil.copytree(ROOT / "docs" / "images", tmp_path / "docs" / "images")
    for name in ("README.md", "docs/results.md"):
        shutil.copy(ROOT / name, tmp_path / name)
    monkeypatch.setattr(script, "ROOT", tmp_path)
    monkeypatch.setattr(script, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(script, "EXPORTS", tmp_path / "docs" / "results")
    monkeypatch.setattr(script, "PAGE", tmp_path / "docs" / "results.md")
    monkeypatch.setattr(script, "README", tmp_path / "README.md")
    return script


def test_page_and_readme_are_what_the_exports_give(page, capsys):
    assert page.main(["--check"]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("name", ["README.md", "docs/results.md"])
def test_a_rate_that_was_typed_is_noticed_and_written_anew(page, tmp_path, capsys, name):
    file = tmp_path / name
    text = file.read_text(encoding="utf-8")
    rate = "99.4 %"
    assert rate in text
    file.write_text(text.replace(rate, "99.9 %"), encoding="utf-8")
    assert page.main(["--check"]) == 1
    assert capsys.readouterr().out == f"{name} is not what the exports give; type make results-page\n"
    assert page.main([]) == 0
    assert file.read_text(encoding="utf-8") == text


def test_a_picture_of_another_export_is_noticed_and_drawn_anew(page, tmp_path, capsys):
    picture = tmp_path / "docs" / "images" / "results_features.png"
    shutil.copy(picture.with_name("results_parked.png"), picture)
    assert page.main(["--check"]) == 1
    assert capsys.readouterr().out == (
        "docs/images/results_features.png is not what the exports give; type make results-page\n"
    )
    assert page.main([]) == 0
    assert page.main(["--check"]) == 0


def test_a_grid_has_a_place_for_each_cell(page):
    features = page._experiment(ROOT / "docs" / "results" / "features")
    grid = features.grid("algorithm.features", "n_envs", env__name="parking").splitlines()
    assert grid[:2] == ["| `features` | `n_envs=256` |", "| :--- | ---: |"]
    assert [line.split(" | ")[0] for line in grid[2:]] == ["| raw", "| ego", "| ego_fine", "| ego_mirrored"]
    with pytest.raises(ValueError, match=r"env\.name and n_envs do not tell features=ego from another cell"):
        features.grid("env.name", "n_envs")
    with pytest.raises(ValueError, match="there is no cell with"):
        features.grid("algorithm.features", "n_envs", env__name="parkng")


def test_levels_of_a_factor_are_compared_over_those_of_another(page):
    whole = page._experiment(ROOT / "docs" / "results" / "her_ablation")
    dense = whole.only("env=parking", baseline="replay")
    found = dense.contrasts("buffer.name", "buffer.n_sampled_goal")
    assert list(found) == [
        *(("her_future", other) for other in ("her_final", "her_episode", "her_random", "replay")),
        *(("her_final", other) for other in ("her_episode", "her_random", "replay")),
        *(("her_episode", other) for other in ("her_random", "replay")),
        ("her_random", "replay"),
    ]
    means = {cell.label: cell.success.value for cell in dense.report.cells}
    future = sum(means[f"her_future, n_sampled_goal={n}"] for n in (1, 2, 4, 8)) / 4
    points = found["her_future", "replay"].split(" ")[0]
    assert float(points) == pytest.approx(100 * (future - means["replay"]), abs=0.05)
    assert dense.mean("buffer", "her_future").split(" ")[0] == f"{100 * future:.1f}"
    assert (dense.better_than("replay"), dense.better_than("her_random, n_sampled_goal=8")) == (2, 1)
    assert dense.better_than("her_future, n_sampled_goal=4") == 0
    assert (dense.real_share("her_random", 8), dense.real_share("replay", None)) == ("13 %", "100 %")
    assert dense.grid("buffer.name", "buffer.n_sampled_goal", metric="crash").splitlines()[2] == (
        "| her_future | 3.4 [0.0, 44.2] | 9.3 [2.6, 21.6] | 14.3 [6.1, 35.8] | 20.5 [7.9, 39.1] |"
    )


def test_every_table_has_a_figure_and_its_command(page):
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    names = [folder.name for folder in EXPORTS.iterdir() if folder.is_dir()]
    assert names
    for name in names:
        assert f"](images/results_{name}.png)" in text
        assert (ROOT / "docs" / "images" / f"results_{name}.png").stat().st_size < 250_000
        assert f"python scripts/train.py experiment={name}" in text


def test_the_exports_are_small_and_name_no_place_of_a_machine():
    files = [file for file in EXPORTS.rglob("*") if file.suffix in {".gz", ".json"}]
    assert len(files) == 5 * len([folder for folder in EXPORTS.iterdir() if folder.is_dir()])
    assert sum(file.stat().st_size for file in files) < MOST_BYTES
    for file in files:
        text = read_text(file)
        assert str(ROOT) not in text
        assert "/tmp/" not in text
        assert "/home/" not in text

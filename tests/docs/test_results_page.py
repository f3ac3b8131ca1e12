"""The pages of results and README's rates agree with the exports in docs/results."""

import functools
import math
import re
import shutil

import numpy as np
import pytest
from support.runs import ROOT, import_script

EXPORTS = ROOT / "docs" / "results"


@pytest.fixture(scope="module")
def script():
    return import_script("results_page")


def test_page_and_readme_agree_with_the_exports_and_a_changed_rate_is_noticed(
    script, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(script, "_experiment", functools.cache(script._experiment))
    assert script.main(["--check"]) == 0
    changed = tmp_path / "docs" / "results.md"
    changed.parent.mkdir()
    changed.write_text(
        (ROOT / "docs" / "results.md").read_text().replace("99.4 [98.6, 99.8]", "99.9 [98.6, 99.8]")
    )
    shutil.copy(ROOT / "README.md", tmp_path)
    for name, path in {"ROOT": tmp_path, "PAGE": changed, "README": tmp_path / "README.md"}.items():
        monkeypatch.setattr(script, name, path)
    assert script.main(["--check"]) == 1
    assert capsys.readouterr().out.startswith("docs/results.md is not up to date")


def test_every_table_has_its_command_every_figure_a_table_and_exports_are_small():
    text = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    full_tables = (ROOT / "docs" / "full_tables.md").read_text(encoding="utf-8")
    tables = {folder.name for folder in EXPORTS.iterdir() if folder.is_dir()}
    assert tables
    assert set(re.findall(r"^## (\w+)$", full_tables, re.MULTILINE)) == tables
    assert [
        name for name in tables if f"python scripts/train.py experiment={name}" not in text
    ] == []
    figures = set(re.findall(r"\]\(images/results_(\w+)\.png\)", text))
    assert tables - figures == {
        "her_ablation",
        "her_learning_rates",
        "raw_learning_rates",
        "published",
        "published_vectorized",
        "lots",
        "feasibility",
        "tight_lots",
        "all_lots",
        "her_lots",
    }  # replaced, tuning, few seeds, in the text, all equal, one seed, a table
    assert figures <= tables
    assert figures == {
        path.stem.removeprefix("results_") for path in (ROOT / "docs" / "images").glob("results_*")
    }
    assert sum(file.stat().st_size for file in EXPORTS.rglob("*")) < 2_000_000


def test_the_least_ratio_of_times_is_the_third_of_25_pairs(script):
    # Five against five: the tabled two-sided 5 % point of Mann and Whitney's U is 2.
    times = np.array([1, 2, 3, 4, 5])
    others = np.array([1, 10, 100, 1000, 10000])
    assert script.least_ratio_of_times(times, others) == pytest.approx(0.0003)
    times_with_limits = np.array([1, 2, 3, math.inf, math.inf])
    assert script.least_ratio_of_times(times_with_limits, others) == pytest.approx(0.0003)
    others_with_a_limit = np.array([1, 10, 100, 1000, math.inf])
    assert script.least_ratio_of_times(times_with_limits, others_with_a_limit) == 0


def test_three_times_against_three_have_no_ratio(script):
    with pytest.raises(ValueError, match="3 and 3 times are too few"):
        script.least_ratio_of_times(np.array([1, 2, 3]), np.array([4, 5, 6]))

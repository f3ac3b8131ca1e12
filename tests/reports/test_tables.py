"""The report's tables: as CSV and LaTeX."""

import csv
import re
import shutil
import subprocess
from dataclasses import replace

import pandas as pd
import pytest
from support import report_factory

from parking_exp.reports import formats
from parking_exp.reports.report_files import escape_formula, write_tables
from parking_exp.reports.sections import section_contents
from parking_exp.reports.tables import report_tables
from parking_exp.statistics import Interval


def written(report, folder):
    """Write the tables of a report; return the rows of each CSV by name."""
    write_tables(section_contents(report), folder)
    return {
        path.stem: list(csv.DictReader(path.open(encoding="utf-8", newline="")))
        for path in folder.glob("*.csv")
    }


def unescaped(text, characters):
    """Occurrences of these characters without a backslash before them."""
    return re.findall(rf"(?<!\\)[{re.escape(characters)}]", text)


def test_spreadsheets_run_no_formula():
    for text in ("=1+1", "+1", "-1", "@SUM(1)", "\t=1", "\r=1"):
        assert escape_formula(text) == f"'{text}"
    assert [escape_formula(value) for value in (-0.5, "a=1", "", None)] == [-0.5, "a=1", "", None]


def test_a_rate_next_to_0_or_1_is_not_written_as_0_or_1():
    rates = (1, 1 - 1e-16, 0.99999, 0.9997, 0.998, 0.5, 0.0003, 0.00001, 0, None)
    texts = ["100.0", "100.0", "99.99", "99.97", "99.8", "50.0", "0.03", "0.01", "0.0", ""]
    assert [formats.percent(rate) for rate in rates] == texts
    differences = (0.032, 0.0003, -0.0003, 1e-17, 0, None)
    texts = ["+3.2", "+0.03", "\u22120.03", "0.0", "0.0", ""]
    assert [formats.points(difference) for difference in differences] == texts


def test_a_p_next_to_the_level_is_written_on_its_own_side():
    values = (0.0505, 0.0504, 0.05, 0.04996, 0.0494, 0.012, 0.00098, 0.00001)
    texts = ["0.051", "0.0504", "0.050", "0.04996", "0.049", "0.012", "0.0010", "≤ 0.0001"]
    assert [formats.p_value(p) for p in values] == texts


def test_tables_have_every_number(tmp_path):
    report = report_factory.her_ablation()
    tables = written(report, tmp_path)
    # The 100 scenes have 27 of the 28 slots as their goal.
    assert {name: len(rows) for name, rows in tables.items()} == {
        "headline": 20,
        "means": 20,
        "seeds": 200,
        "pairs": 19,
        "curves": 400,
        "times": 20,
        "factors": 2,
        "effects": 9,
        "slots": 540,
        "config": 20,
        "versions": 3,
        "common": 7,
    }
    headline = tables["headline"]
    assert [float(row["success"]) for row in headline] == pytest.approx(
        [cell.success.value for cell in report.cells]
    )
    assert headline[0]["label"] == report.cells[0].label
    assert (headline[0]["seeds"], headline[0]["runs_done"]) == ("10", "10")


def test_conditions_that_are_the_same_in_every_row_are_in_the_caption():
    report = report_factory.her_ablation()
    tables = {
        table.name: table
        for content in section_contents(report)
        for table in content.readable_tables
    }
    titles = {name: [column.title for column in table.columns] for name, table in tables.items()}
    assert tables["headline"].caption.endswith(
        " Seeds in every row: 10. Env steps in every row: 40,000."
    )
    assert not {"Seeds", "Env steps"} & {*titles["headline"]}
    assert tables["pairs"].caption.endswith(f" B in every row: {report.labels[report.reference]}.")
    assert (titles["pairs"][:2], "Episodes" in titles["seeds"]) == (["A", "A − B (points)"], False)  # noqa: RUF001
    mixed = [replace(cell, total_timesteps=n) for n, cell in enumerate(report.cells)]
    contents = section_contents(replace(report, cells=mixed))
    (headline,) = (content.readable_tables[0] for content in contents if content.id == "results")
    assert headline.columns[1].title == "Env steps"


def test_settings_are_a_row_for_each_cell_or_where_these_are_fewer_for_each_setting():
    report = report_factory.report(2, 1)
    for keys, titles in ((["a"], ["Cell", "a"]), (["a", "b", "c"], ["Setting", "sac", "td3"])):
        provenance = replace(report.provenance, difference={key: [1, 2] for key in keys})
        (table,) = report_tables.config_table(replace(report, provenance=provenance))
        assert [column.title for column in table.columns] == titles
        assert [table.columns[-1].write(row) for row in table.rows][-1] == "2"


def test_unknown_numbers_are_empty(tmp_path):
    report = report_factory.with_failed_cell()
    odd = replace(report.cells[1], cpu_s=Interval(float("nan"), float("-inf"), float("inf")))
    tables = written(replace(report, cells=[report.cells[0], odd, report.cells[2]]), tmp_path)
    rows = tables["headline"]
    assert [rows[1][name] for name in ("cpu_s", "cpu_s_low", "cpu_s_high")] == ["", "", ""]
    empty = ("success", "success_low", "steps_to_90", "lowest", "iqm", "reaching_95")
    assert [rows[2][name] for name in empty] == [""] * len(empty)
    assert (rows[2]["runs_failed"], rows[0]["reaching_95"]) == ("10", "10")
    failed = [
        line
        for line in (tmp_path / "headline.tex").read_text().splitlines()
        if line.startswith("ddpg")
    ]
    assert failed == [r"ddpg & 0 of 10 & -- & -- & -- & -- \\", r"ddpg & -- \\"]
    assert len(tables["unfinished"]) == 10


@pytest.mark.parametrize("example", [report_factory.with_failed_cell, report_factory.hostile])
def test_pandas_and_latex_read_the_files(example, tmp_path):
    report = example()
    contents = section_contents(report)
    write_tables(contents, tmp_path)
    tables = {table.name: table for content in contents for table in content.tables if table.rows}
    for table in tables.values():
        path = tmp_path / f"{table.name}.csv"
        assert len(pd.read_csv(path, keep_default_na=False)) == len(table.rows)
        assert "nan" not in path.read_text(encoding="utf-8").replace("is nan", "")
    for path in tmp_path.glob("*.tex"):
        text = path.read_text(encoding="utf-8")
        parts = re.findall(
            r"\\begin\{(?:long)?table\}.*?\\end\{(?:long)?table\}", text, flags=re.DOTALL
        )
        assert len(parts) == text.count(r"\caption{") > 0
        for part in parts:
            assert not unescaped(re.search(r"\\caption\{(.*)\}", part)[1], "%#_&")
            n_columns = part.count(r"p{\dimexpr")
            rows = [line for line in part.splitlines() if re.search(r"(?<!\}) \\\\$", line)]
            assert len(rows) == len(tables[path.stem].rows) + part.count(r"\toprule")
            for row in rows:
                assert len(unescaped(row, "&")) == n_columns - 1
                assert not unescaped(row, "%#_")


def long_names(n_cells):
    """A report whose labels and whose settings are long."""
    names = [
        f"her_future, n_sampled_goal={n}, policy_kwargs={{n_critics:{n}}}, averyveryverylongword{n}"
        for n in range(n_cells)
    ]
    report = report_factory.report(n_cells, 2, labels=names)
    difference = {
        f"algorithm.policy_kwargs.key_{n}": names for n in range(n_cells + 1)
    }  # a column for each cell
    return replace(report, provenance=replace(report.provenance, difference=difference))


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("pdflatex") is None,
    reason="pdflatex is not installed: apt-get install texlive-latex-base",
)
@pytest.mark.parametrize("size", ["10pt", "12pt"])
@pytest.mark.parametrize(
    "example",
    [
        lambda: report_factory.report(12, 3),
        lambda: long_names(12),
        report_factory.her_ablation,
        report_factory.with_failed_cell,
        report_factory.hostile,
    ],
    ids=["12 cells", "long names", "crossed", "failed cell", "hostile"],
)
def test_latex_tables_fit_an_article(example, size, tmp_path):
    write_tables(section_contents(example()), tmp_path)
    inputs = [rf"\input{{{path.name}}}" for path in sorted(tmp_path.glob("*.tex"))]
    packages = r"\usepackage{array,booktabs,longtable}"
    lines = [
        rf"\documentclass[{size}]{{article}}",
        packages,
        r"\begin{document}",
        *inputs,
        r"\end{document}",
    ]
    (tmp_path / "paper.tex").write_text("\n".join(lines))
    for _ in range(2):  # a longtable knows its widths after the first time
        command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False
        )
        assert done.returncode == 0, done.stdout[-2000:]
    assert [
        line for line in done.stdout.splitlines() if "Overfull" in line or "too large" in line
    ] == []


def test_a_long_latex_table_is_split_over_pages_and_a_wide_one_into_parts(tmp_path):
    write_tables(section_contents(long_names(12)), tmp_path)
    pairs, config = ((tmp_path / f"{name}.tex").read_text() for name in ("pairs", "config"))
    assert pairs.count(r"\begin{longtable}") == pairs.count(r"\endhead") == 1
    assert r"\begin{table}" not in pairs
    assert r"\label{tab:config}" in config and r"\label{tab:config_2}" in config
    assert config.count(r"\caption{Continued.}") == config.count(r"\label{") - 1

"""The report's tables: as CSV and LaTeX."""

import csv
import re
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
    return {path.stem: list(csv.DictReader(path.open(encoding="utf-8", newline=""))) for path in folder.glob("*.csv")}


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
    assert [formats.points(difference) for difference in differences] == [
        "+3.2",
        "+0.03",
        "\u22120.03",
        "0.0",
        "0.0",
        "",
    ]


def test_tables_have_every_number(tmp_path):
    report = report_factory.her_ablation()
    tables = written(report, tmp_path)
    assert {name: len(rows) for name, rows in tables.items()} == {
        "headline": 20,
        "seeds": 200,
        "pairs": 19,
        "curves": 400,
        "times": 20,
        "survival": sum(len(cell.survival.times) for cell in report.cells),
        "factors": 2,
        "effects": 9,
        "slots": 560,
        "config": 20,
        "versions": 3,
        "common": 7,
    }
    headline = tables["headline"]
    assert [float(row["success"]) for row in headline] == pytest.approx([cell.success.value for cell in report.cells])
    assert (headline[0]["label"], headline[0]["seeds"], headline[0]["runs_done"]) == (report.cells[0].label, "10", "10")


def test_conditions_that_are_the_same_in_every_row_are_in_the_caption():
    report = report_factory.her_ablation()
    tables = {table.name: table for content in section_contents(report) for table in content.readable_tables}
    titles = {name: [column.title for column in table.columns] for name, table in tables.items()}
    assert tables["headline"].caption.endswith(" Seeds in every row: 10. Env steps in every row: 40,000.")
    assert not {"Seeds", "Env steps"} & {*titles["headline"]}
    assert tables["pairs"].caption.endswith(f" B in every row: {report.cell(report.reference).label}.")
    assert (titles["pairs"][:2], "Episodes" in titles["seeds"]) == (["A", "A − B (points)"], False)  # noqa: RUF001
    mixed = [replace(cell, total_timesteps=n) for n, cell in enumerate(report.cells)]
    contents = section_contents(replace(report, cells=mixed))
    (headline,) = (content.readable_tables[0] for content in contents if content.id == "results")
    assert headline.columns[1].title == "Env steps"


def test_settings_are_a_row_for_each_cell_or_where_these_are_fewer_for_each_setting():
    report = report_factory.report(2, 1)
    for keys, titles in ((["a"], ["Cell", "a"]), (["a", "b", "c"], ["Setting", "sac", "td3"])):
        provenance = replace(report.provenance, difference={key: [1, 2] for key in keys})
        (table,) = report_tables.config(replace(report, provenance=provenance))
        assert [column.title for column in table.columns] == titles
        assert [table.columns[-1].write(row) for row in table.rows][-1] == "2"


def test_unknown_numbers_are_empty(tmp_path):
    report = report_factory.with_failed_cell()
    odd = replace(report.cells[1], cpu_s=Interval(float("nan"), float("-inf"), float("inf")))
    tables = written(replace(report, cells=[report.cells[0], odd, report.cells[2]]), tmp_path)
    rows = tables["headline"]
    assert [rows[1][name] for name in ("cpu_s", "cpu_s_low", "cpu_s_high")] == ["", "", ""]
    empty = ("success", "success_low", "survival_median", "lowest", "iqm", "reaching_95_low")
    assert [rows[2][name] for name in empty] == [""] * len(empty)
    assert (rows[2]["runs_failed"], rows[0]["reaching_95_k"]) == ("10", "10")
    failed = (tmp_path / "headline.tex").read_text().splitlines()[-4]
    assert failed == r"ddpg & 0 of 10 & -- & -- & -- & -- & -- & -- & -- & -- & -- & -- \\"
    assert len(tables["unfinished"]) == 10


@pytest.mark.parametrize("example", [report_factory.with_failed_cell, report_factory.hostile])
def test_pandas_and_latex_read_the_files(example, tmp_path):
    report = example()
    contents = section_contents(report)
    write_tables(contents, tmp_path)
    for table in (table for content in contents for table in content.tables if table.rows):
        path = tmp_path / f"{table.name}.csv"
        assert len(pd.read_csv(path, keep_default_na=False)) == len(table.rows)
        assert "nan" not in path.read_text(encoding="utf-8").replace("is nan", "")
    for path in tmp_path.glob("*.tex"):
        text = path.read_text(encoding="utf-8")
        assert text.count(r"\begin{table}") == text.count(r"\end{table}") == text.count(r"\toprule")
        assert not unescaped(re.search(r"\\caption\{(.*)\}", text)[1], "%#_&")
        body = text.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
        columns = re.search(r"\\begin\{tabular\}\{([lr]+)\}", text)[1]
        for line in body.strip().splitlines():
            assert line.endswith(r" \\")
            assert len(unescaped(line, "&")) == len(columns) - 1
            assert not unescaped(line, "%#_")

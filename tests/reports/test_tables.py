"""The report's tables: as CSV, LaTeX and Markdown."""

import csv
import re
from dataclasses import replace

import pandas as pd
import pytest
from support import report_factory

from parking_exp.reports import formats
from parking_exp.reports.render.report_pages import escaped, markdown
from parking_exp.reports.report_files import csv_text, latex_text, write_tables
from parking_exp.reports.sections import Picture, section_contents
from parking_exp.statistics import Interval


def written(report, folder):
    """Write the tables of a report; return the rows of each CSV by name."""
    write_tables(section_contents(report), report.shown, folder)
    return {path.stem: list(csv.DictReader(path.open(encoding="utf-8", newline=""))) for path in folder.glob("*.csv")}


def unescaped(text, characters):
    """Occurrences of these characters without a backslash before them."""
    return re.findall(rf"(?<!\\)[{re.escape(characters)}]", text)


@pytest.mark.parametrize(
    ("interval", "text"),
    [(Interval(0.944, 0.912, 0.971), "94.4 [91.2, 97.1]"), (Interval(0.5, None, 0.6), "50.0"), (Interval(None), "")],
)
def test_percentages_with_intervals(interval, text):
    assert formats.percent_interval(interval) == text


@pytest.mark.parametrize(
    ("escape", "text", "expected"),
    [
        (latex_text, "a&b%c$d#e_f{g}", r"a\&b\%c\$d\#e\_f\{g\}"),
        (
            latex_text,
            "~^\\<a>|",
            r"\textasciitilde{}\textasciicircum{}\textbackslash{}\textless{}a\textgreater{}\textbar{}",
        ),
        (latex_text, "[2pt] two\nlines\x00", "{}[2pt] two lines"),
        (latex_text, "Größe α 学習", "Größe α 学習"),  # noqa: RUF001
        (escaped, "[c](javascript:alert(1))", r"\[c\](javascript:alert(1))"),
        (escaped, "<b>&lt; a|b \\", r"\<b\>\&lt; a\|b \\"),
        (escaped, "`x` *y* _z_ ~w~ $m$ # !", r"\`x\` \*y\* \_z\_ \~w\~ \$m\$ \# \!"),
        (escaped, "1. one", r"1\. one"),
        (escaped, "- two\n\nlines", r"\- two lines"),
        (escaped, "-0.5 [1.12, 2]", r"-0.5 \[1.12, 2\]"),
    ],
)
def test_latex_and_markdown_are_escaped(escape, text, expected):
    assert escape(text) == expected


def test_spreadsheets_run_no_formula():
    for text in ("=1+1", "+1", "-1", "@SUM(1)", "\t=1", "\r=1"):
        assert csv_text(text) == f"'{text}"
    assert [csv_text(value) for value in (-0.5, "a=1", "", None)] == [-0.5, "a=1", "", None]


def test_tables_have_every_number(tmp_path):
    report = report_factory.her_ablation()
    tables = written(report, tmp_path)
    clocks = [clock for cell in report.cells for clock in (cell.survival, cell.survival_cpu)]
    assert {name: len(rows) for name, rows in tables.items()} == {
        "headline": 20,
        "seeds": 200,
        "pairs": 19,
        "curves": 400,
        "survival": sum(len(clock.time) + len(clock.censored) for clock in clocks),
        "effects": 9,
        "interactions": 20,
        "slots": 560,
        "config": 20,
        "versions": 3,
    }
    first, cell = tables["interactions"][0], report.cells[10]
    assert (first["row"], first["column"], first["real_share"]) == ("her_episode", "1", "0.5")
    assert float(first["mean"]) == pytest.approx(cell.success.value)
    headline = tables["headline"]
    assert [float(row["success"]) for row in headline] == pytest.approx([cell.success.value for cell in report.cells])
    assert (headline[0]["label"], headline[0]["seeds"], headline[0]["runs_done"]) == (report.cells[0].label, "10", "10")


def test_unknown_numbers_are_empty(tmp_path):
    report = report_factory.with_failed_cell()
    odd = replace(report.cells[1], cpu_s=Interval(float("nan"), float("-inf"), float("inf")))
    tables = written(replace(report, cells=[report.cells[0], odd, report.cells[2]]), tmp_path)
    rows = tables["headline"]
    assert [rows[1][name] for name in ("cpu_s", "cpu_s_low", "cpu_s_high")] == ["", "", ""]
    assert [rows[2][name] for name in ("success", "success_low", "survival_median", "reaching_90_low")] == [""] * 4
    assert (rows[2]["runs_failed"], rows[0]["reaching_90_k"]) == ("10", "10")
    failed = (tmp_path / "headline.tex").read_text().splitlines()[-4]
    assert failed == r"ddpg & 0 of 10 & -- & -- & -- & -- & -- & -- & -- & 40,000 & -- \\"
    assert len(tables["failed"]) == 10


@pytest.mark.parametrize("example", [report_factory.with_failed_cell, report_factory.hostile])
def test_pandas_and_latex_read_the_files(example, tmp_path):
    report = example()
    contents = section_contents(report)
    write_tables(contents, report.shown, tmp_path)
    for table in (table for content in contents for table in content.tables if table.csv and table.rows):
        path = tmp_path / f"{table.stem}.csv"
        assert len(pd.read_csv(path, keep_default_na=False)) == len(table.rows)
        assert "nan" not in path.read_text(encoding="utf-8").replace("is nan", "")
    for path in tmp_path.glob("*.tex"):
        text = path.read_text(encoding="utf-8")
        assert text.count(r"\begin{table}") == text.count(r"\end{table}") == text.count(r"\toprule")
        body = text.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
        columns = re.search(r"\\begin\{tabular\}\{([lr]+)\}", text)[1]
        for line in body.strip().splitlines():
            assert line.endswith(r" \\")
            assert len(unescaped(line, "&")) == len(columns) - 1
            assert not unescaped(line, "%#_")


def test_markdown_tables_have_as_many_cells_in_every_row():
    report = report_factory.hostile()
    text = markdown(report, section_contents(report), None)
    blocks = [block for block in text.split("\n\n") if block.startswith("|")]
    assert len(blocks) >= 4
    for block in blocks:
        assert len({len(unescaped(line, "|")) for line in block.splitlines()}) == 1
    assert not unescaped(re.sub(r"(?m)^    .*$|</?(details|summary)>", "", text), "<")


def test_of_many_cells_latex_and_markdown_have_those_of_the_figures(tmp_path):
    report = report_factory.report(20, 1)
    tables = written(report, tmp_path)
    assert (tmp_path / "headline.tex").read_text().count("\\\\\n") == 1 + 12
    assert len(tables["headline"]) == 20
    assert "12 of 20 rows; `tables/` holds them all." in markdown(report, section_contents(report), None)


def test_markdown_has_the_warnings_claims_figures_tables_and_command():
    report = replace(report_factory.report(3, 5), quick=True, missing=["7 runs are under way."])
    picture = Picture("final_success", "Final success", "Each point is a seed.", b"", "results")
    text = markdown(report, section_contents(report, [picture]), "png")
    assert text.startswith("# algorithms\n\n**Preliminary**")
    for part in (
        "**Exploratory**: fewer than 10 seeds",
        "- 7 runs are under way.",
        "![Final success](figures/final_success.png)\n\nEach point is a seed.",
        "| Cell | Seeds | Success (%) |",
        escaped(report.claims[0]),
        "    python scripts/report.py experiment=algorithms",
    ):
        assert part in text

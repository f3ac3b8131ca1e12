"""The report's tables: as CSV, LaTeX and Markdown."""

import csv
import re
from dataclasses import replace
from operator import itemgetter
from typing import NamedTuple

import pandas as pd
import pytest
from parking_exp.reports.render.files import write_tables
from parking_exp.reports.render.markdown import markdown
from parking_exp.reports.tables.model import Column, Entry, Table
from parking_exp.reports.tables.writers import latex
from support import report_factory

from parking_exp.reports import formats
from parking_exp.reports.report_data import Interval, Share
from parking_exp.reports.sections import provenance_tables, report_tables

EXAMPLES = [
    report_factory.report,
    report_factory.one_seed,
    report_factory.all_succeed,
    report_factory.with_failed_cell,
    report_factory.her_ablation,
    report_factory.search,
    report_factory.hostile,
    report_factory.non_ascii,
]


def read(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def in_csv(report):
    """Tables of CSV that have rows, by the name of their file."""
    return {table.stem: table for table in report_tables(report, report.cells) if table.rows and table.csv}


def unescaped(text, characters):
    """Occurrences of these characters without a backslash before them."""
    return re.findall(rf"(?<!\\)[{re.escape(characters)}]", text)


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        (Interval(0.944, 0.912, 0.971), "94.4 [91.2, 97.1]"),
        (Interval(1.0), "100.0"),
        (Interval(None), ""),
        (Interval(float("nan"), 0.1, 0.2), ""),
        (Interval(0.5, None, 0.6), "50.0"),
        (Interval(0.5, float("-inf"), 0.6), "50.0"),
        (Share(9, 10, 0.596, 0.982), "90.0 [59.6, 98.2]"),
        (Share(0, 0, None, None), ""),
    ],
)
def test_percentages_with_intervals(interval, text):
    assert formats.percent_interval(interval) == text


def test_differences_have_a_sign():
    assert formats.percent_interval(Interval(-0.05, -0.1, 0.0), signed=True) == "−5.0 [−10.0, +0.0]"  # noqa: RUF001


@pytest.mark.parametrize(
    ("p", "text"), [(0.0004, "<0.001"), (0.0123, "0.012"), (1.0, "1.000"), (None, ""), (float("nan"), "")]
)
def test_p_values(p, text):
    assert formats.probability(p) == text


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("a&b%c$d#e_f{g}", r"a\&b\%c\$d\#e\_f\{g\}"),
        ("~^\\", r"\textasciitilde{}\textasciicircum{}\textbackslash{}"),
        (r"\input{x}", r"\textbackslash{}input\{x\}"),
        ("<a>|", r"\textless{}a\textgreater{}\textbar{}"),
        ("[2pt] x", "{}[2pt] x"),
        ("*", "{}*"),
        ("two\nlines\x00", "two lines"),
        ("Größe α 学習", "Größe α 学習"),  # noqa: RUF001
    ],
)
def test_latex_is_escaped(text, escaped):
    assert formats.latex(text) == escaped


@pytest.mark.parametrize(
    ("text", "escaped"),
    [
        ("a|b", r"a\|b"),
        ("[c](javascript:alert(1))", r"\[c\](javascript:alert(1))"),
        ("<b>&lt;", r"\<b\>\&lt;"),
        ("`x` *y* _z_ ~w~ $m$ # !", r"\`x\` \*y\* \_z\_ \~w\~ \$m\$ \# \!"),
        ("back\\slash", r"back\\slash"),
        ("1. one", r"1\. one"),
        ("- one", r"\- one"),
        ("---", r"\---"),
        ("-0.5 [1.12, 2]", r"-0.5 \[1.12, 2\]"),
        ("1.12.1", "1.12.1"),
        ("two\n\nlines", "two lines"),
    ],
)
def test_markdown_is_escaped(text, escaped):
    assert formats.markdown(text) == escaped


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@SUM(1)", "\t=1", "\r=1"])
def test_spreadsheets_run_no_formula(text):
    assert formats.csv(text) == f"'{text}"


@pytest.mark.parametrize("value", [-0.5, "a=1", "", None, True])
def test_what_is_no_formula_stays(value):
    assert formats.csv(value) is value


@pytest.mark.parametrize("example", EXAMPLES)
def test_headline_has_a_row_for_each_cell(example):
    report = example()
    table = in_csv(report)["headline"]
    for key, values in (
        ("label", [cell.label for cell in report.cells]),
        ("success", [cell.success.value for cell in report.cells]),
    ):
        assert [table.csv[key](row) for row in table.rows] == values


def test_tables_have_every_number():
    report = report_factory.her_ablation()
    found = in_csv(report)
    assert {name: len(table.rows) for name, table in found.items()} == {
        "headline": 20,
        "seeds": 200,
        "pairs": 190,
        "curves": 400,
        "survival": sum(len(s.time) + len(s.censored) for c in report.cells for s in (c.survival, c.survival_cpu)),
        "effects": 9,
        "interactions": 20,
        "slots": 560,
        "config": 20,
        "versions": 5,
    }
    table = found["interactions"]
    first = {key: get(table.rows[0]) for key, get in table.csv.items()}
    assert (first["row"], first["column"], first["real_share"]) == ("her_future", 1, 0.5)
    assert first["success"] == report.cells[0].success.value
    assert [found["headline"].csv["seeds"](cell) for cell in report.cells] == [10] * 20


def test_unknown_numbers_are_empty(tmp_path):
    report = report_factory.with_failed_cell()
    odd = replace(report.cells[1], cpu_s=Interval(float("nan"), float("-inf"), float("inf")))
    write_tables(replace(report, cells=[report.cells[0], odd, report.cells[2]]), tmp_path)
    rows = read(tmp_path / "headline.csv")
    assert [rows[1][name] for name in ("cpu_s", "cpu_s_low", "cpu_s_high")] == ["", "", ""]
    assert [rows[2][name] for name in ("success", "success_low", "steps_to_90_median", "share_reaching_90")] == [""] * 4
    assert rows[2]["runs_failed"] == "10"
    assert rows[0]["seeds_reaching_90"] == "10"
    failed = (tmp_path / "headline.tex").read_text().splitlines()[-4]
    assert failed == r"ddpg & 0 of 10 & -- & -- & -- & -- & -- & -- & -- & 40,000 & -- \\"
    assert len(read(tmp_path / "failed.csv")) == 10


@pytest.mark.parametrize("example", EXAMPLES)
def test_files_are_written_and_read_again(example, tmp_path):
    report = example()
    files = write_tables(report, tmp_path)
    assert {path.name for path in files} == {path.name for path in tmp_path.iterdir()}
    for name, table in in_csv(report).items():
        again = pd.read_csv(tmp_path / f"{name}.csv", keep_default_na=False)
        assert again.shape == (len(table.rows), len(table.csv))
        assert "nan" not in (tmp_path / f"{name}.csv").read_text(encoding="utf-8").replace("is nan", "")
    for path in tmp_path.glob("*.tex"):
        text = path.read_text(encoding="utf-8")
        assert text.count(r"\begin{table}") == text.count(r"\end{table}") == text.count(r"\toprule")
        body = text.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
        columns = re.search(r"\\begin\{tabular\}\{([lr]+)\}", text)[1]
        for line in body.strip().splitlines():
            assert line.endswith(r" \\")
            assert len(unescaped(line, "&")) == len(columns) - 1
            assert not unescaped(line, "%#_")


def test_hostile_names_in_csv_keep_their_text(tmp_path):
    report = report_factory.hostile()
    write_tables(report, tmp_path)
    labels = [row["label"] for row in read(tmp_path / "headline.csv")]
    assert labels == [*report_factory.HOSTILE[:4], f"'{report_factory.HOSTILE[4]}"]


def test_latex_table_is_exact():
    columns = [Column("Cell", itemgetter(0)), Column("Success (%)", itemgetter(1), numeric=True)]
    rows = [[Entry("a_b"), Entry("94.4 [91.2, 97.1]", 0.944)], [Entry("[c]"), Entry("")]]
    assert latex(Table("pairs", columns, rows, "Gain of 5 %.")) == (
        "\\begin{table}[htbp]\n"
        "\\centering\n"
        "\\caption{Gain of 5 \\%.}\n"
        "\\label{tab:pairs}\n"
        "\\begin{tabular}{lr}\n"
        "\\toprule\n"
        "Cell & Success (\\%) \\\\\n"
        "\\midrule\n"
        "a\\_b & 94.4 [91.2, 97.1] \\\\\n"
        "{}[c] & -- \\\\\n"
        "\\bottomrule\n"
        "\\end{tabular}\n"
        "\\end{table}\n"
    )


def test_paper_has_the_cells_of_the_figures(tmp_path):
    report = report_factory.report(80, 3)
    write_tables(report, tmp_path)
    text = (tmp_path / "headline.tex").read_text()
    assert text.count("\\\\\n") == 1 + 12
    assert len(read(tmp_path / "headline.csv")) == 80


def test_config_goes_down_the_page_along_its_longer_side():
    def read(report):
        return provenance_tables(report, report.cells)["config"]

    wide, long = report_factory.report(3), report_factory.her_ablation()
    assert [column.title for column in read(wide).headings] == ["Cell", "algorithm"]
    two = replace(wide.provenance, difference={f"key{i}": [1, None, True] for i in range(4)})
    turned = read(replace(wide, provenance=two))
    assert [column.title for column in turned.headings] == ["Setting", "sac", "td3", "ddpg"]
    assert [entry.text for entry in turned.entries()[0]] == ["key0", "1", "null", "true"]
    assert len(read(long).rows) == 20


class Picture(NamedTuple):
    name: str
    title: str
    caption: str
    svg: str = ""


def test_markdown_tables_have_as_many_cells_in_every_row():
    text = markdown(report_factory.hostile())
    blocks = [block for block in text.split("\n\n") if block.startswith("|")]
    assert len(blocks) >= 4
    for block in blocks:
        assert len({len(unescaped(line, "|")) for line in block.splitlines()}) == 1
    assert not unescaped(text.replace("    python scripts/report.py", "").split("<details>")[0].replace(
        f"experiment='{report_factory.HOSTILE[0]}'", ""), "<")  # fmt: skip


def test_markdown_says_what_the_page_says():
    report = replace(
        report_factory.report(3, 5), quick=True, missing=["7 runs are under way."], warnings=["Mixed versions."]
    )
    text = markdown(report, [Picture("final_success", "Final success", "Each point is a seed.")])
    assert text.startswith("# algorithms\n\n**Preliminary**")
    for part in (
        "**Exploratory**: fewer than 10 seeds",
        "- 7 runs are under way.",
        "- Mixed versions.",
        "![Final success](figures/final_success.png)\n\nEach point is a seed.",
        "| Cell | Seeds | Success (%) |",
        report.claims[0],
        "    python scripts/report.py experiment=algorithms",
        "| highway-env | 1.12.1 | 15 |",
    ):
        assert part in text


def test_long_tables_in_markdown_say_what_they_leave_out():
    assert "12 of 50 rows; `tables/` holds them all." in markdown(report_factory.report(50, 2))

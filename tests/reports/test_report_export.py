"""A report that is made from an export says what one from the store says."""

import json
import shutil
from dataclasses import replace

import pytest
from support.report_command import report
from support.runs import copy_of, names_in
from support.searches import settings
from support.store_factory import Look, make_store

from parking_exp.reports.make_report import ReportSource, read_report_export, write_report_export
from parking_exp.reports.report_builder import build_report
from parking_exp.reports.search_report import with_search
from parking_exp.results import load, write_export
from parking_exp.tuning.search import StoredSearch
from parking_exp.tuning.trials import RetestedTrial, TrialRow

CELLS = {
    f"{buffer}{n}": [
        f"buffer=her_{buffer}",
        f"buffer.n_sampled_goal={n}",
        "evaluation.final_n_scenes=40",
    ]
    for buffer in ("future", "final")
    for n in (1, 4)
}


def look(label, seed):
    if (label, seed) == ("final4", 1):
        return Look(status="failed", error="no file /tmp/here/x.zip", curve=(0.2, 0.9, 0.9, 0.9))
    if (label, seed) == ("final4", 2):
        return Look(status="interrupted")
    curve = (0.1, 1 / 3, 0.9 + seed / 100, 0.95, 1.0) if label.startswith("future") else None
    return Look(success=0.3, crash=0.4, steps=150, cpu_s=200 / 3 + seed, curve=curve)


@pytest.fixture(scope="module")
def store(empty):
    """An output directory with four cells, of which one has a failed and an interrupted run."""
    with copy_of(empty) as folder:
        make_store(folder, "one", CELLS, range(3), look)
        yield folder


@pytest.fixture(scope="module")
def source(store):
    results = load("one", output_dir=store)
    problems = (f"The store lacks {store}/x: no.", *results.problems)
    return ReportSource(replace(results, problems=problems))


@pytest.fixture(scope="module")
def folder(source, tmp_path_factory):
    """The export of the report on all cells."""
    folder = tmp_path_factory.mktemp("exports") / "one"
    write_report_export(source, report_of(source), folder, only_cells=False)
    return folder


def report_of(source, **options):
    return build_report(source.results, ["one"], quick=True, **options)


def differences(value, other, key=""):
    """Keys at which two JSON values differ by more than rounding does."""
    if isinstance(value, dict):
        assert value.keys() == other.keys(), key
        return [
            differing for name in value for differing in differences(value[name], other[name], name)
        ]
    if isinstance(value, list | tuple):
        assert len(value) == len(other), key
        return [
            differing
            for a, b in zip(value, other, strict=True)
            for differing in differences(a, b, key)
        ]
    if isinstance(value, float) and isinstance(other, float):
        return [] if value == pytest.approx(other, rel=1e-3, abs=1e-5) else [key]
    return [] if value == other else [key]


def test_a_report_from_an_export_differs_in_places_and_rounding_only(source, store, folder):
    from_store, from_export = report_of(source), report_of(read_report_export(str(folder)))
    contents = [
        replace(report, warnings=[], made="").plain() for report in (from_store, from_export)
    ]
    assert set(differences(*contents)) == {"uri", "run_dir", "reason"}
    assert from_export.provenance.uri == str(folder)
    assert [run.reason for run in from_export.provenance.unfinished if run.status == "failed"] == [
        "no file x.zip"
    ]
    assert f"The store lacks {store}/x: no." in from_store.warnings
    assert sorted(from_export.warnings) == sorted(
        text.replace(f"{store}/x", "x") for text in from_store.warnings
    )


def test_an_export_of_some_cells_has_no_others(source, folder, tmp_path):
    options = {"baseline": "her_future, n_sampled_goal=1", "cells": ["her_final*"]}
    selected = report_of(source, **options)
    assert selected.claims == report_of(read_report_export(str(folder)), **options).claims
    write_report_export(source, selected, tmp_path / "one", only_cells=True)
    export = read_report_export(str(tmp_path / "one"))
    runs = export.results.runs
    curves = export.results.curves
    episodes = export.results.episodes
    assert set(runs["cell"]) == {cell.name for cell in selected.cells}
    assert len(runs) == 9
    assert set(curves["run_id"]) | set(episodes["run_id"]) <= set(runs["run_id"])


def test_the_search_of_an_export_is_the_one_that_was_written(source, tmp_path):
    space = {
        "algorithm.gamma": {"uniform": [0.9, 0.99]},
        "buffer": {"choices": ["her_future", "replay"]},
    }
    parameters = {"algorithm.gamma": 0.9, "buffer": "replay"}
    trial = TrialRow(0, "done", {}, parameters, 0.5, [0.25, 0.75], ["one/cell/seed=0"])
    retested = RetestedTrial(0, "trial 0: unchanged", {}, [0.5], [0.5])  # one seed: no interval
    search = StoredSearch("one", 2, settings(space=space), [trial], [retested])
    data = with_search(report_of(source), search)
    write_report_export(source, data, tmp_path / "one", only_cells=False)
    export = read_report_export(str(tmp_path / "one"))
    assert export.search == search
    assert with_search(report_of(export), export.search).claims == data.claims


def test_an_export_written_in_python_has_the_same_report(source, folder, tmp_path):
    write_export(source.results, tmp_path / "own")
    own = read_report_export(str(tmp_path / "own"))
    assert own.search is None
    assert report_of(own).claims == report_of(read_report_export(str(folder))).claims
    report(tmp_path, "from=own", "report.formats=[]")
    assert (tmp_path / "reports" / "one" / "index.html").is_file()


def test_an_export_whose_report_is_no_mapping_is_a_sentence(folder, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    about = json.loads((copy / "report.json").read_text())
    about["report"] = "all"
    (copy / "report.json").write_text(json.dumps(about) + "\n")
    assert f"{copy}/report.json" in report(tmp_path, f"from={copy}", code=2).stderr


def test_the_command_writes_an_export_and_reports_on_it_without_a_store(output_dir, tmp_path):
    cells = {"sac": [], "td3": ["algorithm=td3"]}
    make_store(
        output_dir, "one", cells, range(3), lambda label, _: Look(0.8 if label == "sac" else 0.2)
    )
    options = ["baseline=td3", "report.formats=[]"]
    from_store = report(
        output_dir, "experiment=one", "export=docs/results/own name", *options
    ).stdout.splitlines()
    folder = output_dir / "docs" / "results" / "own name"
    assert f"export         {folder}" in from_store
    shutil.copytree(folder, tmp_path / "theirs")
    from_export = report(tmp_path, "from=theirs", *options).stdout.splitlines()
    assert from_export[:-1] == [line for line in from_store[:-1] if not line.startswith("export")]
    numbers = json.loads((tmp_path / "reports" / "one" / "report.json").read_text())
    assert numbers["provenance"]["uri"] == "theirs"
    assert names_in(tmp_path) == ["reports", "theirs"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["from=ex", "experiment=one"], ["experiment", "from=ex"]),
        (["from=ex", "export=other"], ["export", "from=ex"]),
        (["from=2024"], ["2024"]),
        (["exprot=ex"], ["exprot", "'export'"]),
        (["experiment=one", "export=full"], ["export=", "full", "notes.txt"]),
    ],
)
def test_a_mistake_names_the_key_and_writes_nothing(tmp_path, arguments, words):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    message = report(tmp_path, *arguments, code=2).stderr
    assert message.startswith("error: ")
    assert all(word in message for word in words)
    assert names_in(tmp_path) == ["full"]

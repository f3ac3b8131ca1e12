"""A report that is made from an export says what one from the store says."""

import json
import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from support.marks import slow_but
from support.report_command import report
from support.runs import in_memory, read_text
from support.store_factory import Look, make_store

from parking_exp.reports import lot_map
from parking_exp.reports.cell_summaries import RunEvaluations
from parking_exp.reports.report_builder import build_report
from parking_exp.reports.report_export import ReportSource, read_report_export, write_report_export
from parking_exp.reports.search_report import Tuning, with_tuning
from parking_exp.results import load, read_export
from parking_exp.tuning.trials import TrialRow

CELLS = {
    f"{buffer}{n}": [f"buffer=her_{buffer}", f"buffer.n_sampled_goal={n}", "evaluation.final_n_scenes=40"]
    for buffer in ("future", "final") for n in (1, 4)
}  # fmt: skip
AT_A_PLACE = {"made", "command", "uri", "run_dir"}


def look(label, seed):
    if (label, seed) == ("final4", 1):
        return Look(status="failed", error="no file /tmp/here/x.zip", curve=(0.2, 0.9, 0.9, 0.9))
    if (label, seed) == ("final4", 2):
        return Look(status="interrupted")
    contents = {"trajectories.npz": b"damaged"} if (label, seed) == ("final1", 0) else {}
    curve = (0.1, 1 / 3, 0.9 + seed / 100, 0.95, 1.0) if label.startswith("future") else None
    # Ways of 150 steps are thinned.
    return Look(
        success=0.3, crash=0.4, steps=150, trajectories=40, cpu_s=200 / 3 + seed, curve=curve, contents=contents
    )


@pytest.fixture(scope="module")
def store(empty):
    """An output directory with four cells, of which one has a failed and a cut off run."""
    with in_memory() as folder:
        shutil.copy(empty / "mlflow.db", folder)
        make_store(Path(folder), "one", CELLS, range(3), look)
        yield Path(folder)


@pytest.fixture(scope="module")
def source(store):
    results = load("one", output_dir=store)
    return ReportSource(replace(results, problems=(f"The store lacks {store}/x: no.", *results.problems)), ["one"])


@pytest.fixture(scope="module")
def folder(source, tmp_path_factory):
    """The export of the report on all cells."""
    folder = tmp_path_factory.mktemp("exports") / "one"
    write_report_export(source, made_of(source), folder, "python scripts/report.py from=one", only_cells=False)
    return folder


def made_of(source, **options):
    return build_report(source.results, ["one"], quick=True, **options)


def differences(one, other, key=""):
    """Keys at which two JSON values differ by more than rounding does."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), key
        return [found for name in one for found in differences(one[name], other[name], name)]
    if isinstance(one, list | tuple):
        assert len(one) == len(other), key
        return [found for a, b in zip(one, other, strict=True) for found in differences(a, b, key)]
    if isinstance(one, float) and isinstance(other, float):
        return [] if one == pytest.approx(other, rel=1e-3, abs=1e-5) else [key]
    return [] if one == other else [key]


def test_a_report_from_an_export_is_the_same_but_for_places_and_rounding(source, store, folder):
    from_store, from_export = made_of(source), made_of(read_report_export(str(folder)))
    sentences = [replace(one, warnings=[], made="") for one in (from_store, from_export)]
    assert set(differences(*(one.plain() for one in sentences))) == {"uri", "run_dir", "reason"}
    assert from_export.provenance.uri == str(folder)
    assert [run.reason for run in from_export.provenance.unfinished if run.status == "failed"] == ["no file x.zip"]
    assert {run.status for run in from_export.provenance.unfinished} == {"failed", "interrupted"}
    assert from_export.missing == ["10 of 12 runs are done: 1 failed, 1 interrupted or not started."]
    assert f"The store lacks {store}/x: no." in from_store.warnings
    assert sorted(from_export.warnings) == sorted(one.replace(f"{store}/x", "x") for one in from_store.warnings)
    assert any("trajectories.npz can't be read" in one for one in from_export.warnings)
    assert sum(len(cell.paths) for cell in from_export.cells) > 20
    assert all(len(cell.failures) > 10 for cell in from_export.cells)


@pytest.mark.parametrize(
    "changes", slow_but([{"cells": ["her_final*"]}], [{"cells": ["her_final*"]}, {"cells": ["n_sampled_goal=1"]}])
)
def test_other_cells_and_another_baseline_can_be_asked_for(source, folder, changes):
    options = {"baseline": "her_future, n_sampled_goal=1", **changes}
    from_store, from_export = made_of(source, **options), made_of(read_report_export(str(folder)), **options)
    assert len(from_export.cells) == (3 if "her_final*" in changes["cells"] else 2)
    assert {pair.b for pair in from_export.pairs} == {from_export.baseline}
    assert [asdict(path) for cell in from_export.cells for path in cell.paths] == [
        asdict(path) for cell in from_store.cells for path in cell.paths
    ]
    assert from_export.claims == from_store.claims


def test_of_many_episodes_some_are_drawn_at_random_and_the_same_ones_from_the_export(source, tmp_path, monkeypatch):
    monkeypatch.setattr(lot_map, "MOST_FAILURES", 7)
    monkeypatch.setattr(lot_map, "PATHS_AN_OUTCOME", 2)
    results = source.results
    runs = results.runs[(results.runs["status"] == "done")]
    write_report_export(source, made_of(source), tmp_path / "one", "", only_cells=False)
    kept = read_export(tmp_path / "one")
    final = RunEvaluations.of(results).final
    for _, cell in runs.groupby("cell"):
        pairs = list(zip(cell["seed"].tolist(), cell["run_id"].tolist(), strict=True))
        for vehicles in (0, 3):
            ours, theirs = (lot_map.sample(pairs, frames, final, vehicles) for frames in (results, kept))
            paths, drawn, _ = ours
            assert (len(paths), len(drawn)) == (3 if vehicles else 6, 7)
            assert theirs[:2] == (paths, drawn)
        with monkeypatch.context() as patch:
            patch.setattr(lot_map, "MOST_FAILURES", 500)
            _, everything, _ = lot_map.sample(pairs, results, final, 0)
        rest = iter(everything)
        assert all(failure in rest for failure in drawn)  # in the same order
        assert drawn != everything[:7]  # not the first ones


def test_long_ways_have_every_fifth_place_and_the_last_and_their_length(source):
    paths = [path for cell in made_of(source).cells for path in cell.paths]
    assert {path.steps for path in paths} <= set(range(145, 156))
    for path in paths:
        assert len(path.x_m) == -(-path.steps // 5) + 1
        assert path.x_m[0] == 0


def test_the_summary_has_what_tables_have_not_and_is_small(source, folder):
    about = json.loads((folder / "report.json").read_text())
    assert about["experiments"] == ["one"]
    assert about["report"]["command"] == "python scripts/report.py from=one"
    cell, whole = about["report"]["cells"][0], made_of(source).cells[0]
    assert not {"seeds", "curve", "survival", "slots", "failures", "paths"} & {*cell}
    assert cell["success"]["value"] == float(f"{whole.success.value:.6g}")
    assert all(len(json.dumps(one, separators=(",", ":"))) < 2000 for one in about["report"]["cells"])
    text = "".join(read_text(path) for path in folder.iterdir())
    assert not re.search(r"/(tmp|dev|home|root|work)\b|sqlite:|run_dir|\.zip: /", text)


def test_the_same_report_gives_the_same_bytes(source, folder, tmp_path):
    write_report_export(
        source, made_of(source), tmp_path / "one", "python scripts/report.py from=one", only_cells=False
    )
    assert all(path.read_bytes() == (folder / path.name).read_bytes() for path in (tmp_path / "one").iterdir())


def test_an_export_of_some_cells_has_no_others(source, tmp_path):
    asked = made_of(source, cells=["her_final*"])
    write_report_export(source, asked, tmp_path / "one", "", only_cells=True)
    found = read_report_export(str(tmp_path / "one"))
    assert set(found.results.runs["cell"]) == {cell.name for cell in asked.cells}
    assert len(found.results.runs) == 6
    assert set(found.results.curves["run_id"]) | set(found.results.episodes["run_id"]) <= set(
        found.results.runs["run_id"]
    )
    assert [cell.label for cell in made_of(found).cells] == ["n_sampled_goal=1", "n_sampled_goal=4"]


def test_the_search_of_an_export_is_the_one_that_was_written(source, tmp_path):
    kind = {"name": "FloatDistribution", "attributes": {"low": 0.9, "high": 0.99, "log": False, "step": None}}
    trial = TrialRow(0, "done", {}, {"algorithm.gamma": 0.9}, 0.5, [0.25, 0.75], ["one/cell/seed=0"], 100)
    search = Tuning("one", "tpe", None, 2, "success_auc", 2, {"algorithm.gamma": kind}, [trial], retested=[])
    data = with_tuning(made_of(source), search)
    write_report_export(source, data, tmp_path / "one", "", only_cells=False)
    found = read_report_export(str(tmp_path / "one"))
    assert found.tuning == search
    assert with_tuning(made_of(found), found.tuning).claims == data.claims


@pytest.mark.parametrize("entry", ["experiments", "report"])
def test_an_export_without_a_report_is_a_sentence(folder, tmp_path, entry):
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    about = json.loads((copy / "report.json").read_text())
    del about[entry]
    (copy / "report.json").write_text(json.dumps(about) + "\n")
    _, said = report(tmp_path, f"from={copy}", code=2)
    assert f"{copy}/report.json" in said


def test_the_command_writes_an_export_and_makes_the_report_from_it_without_a_store(output_dir, tmp_path):
    make_store(output_dir, "one", {"sac": [], "td3": ["algorithm=td3"]}, range(3), plain_look)
    said, _ = report(output_dir, "experiment=one", "export=docs/results/own name", "baseline=td3", "report.formats=[]")
    folder = output_dir / "docs" / "results" / "own name"
    assert f"export         {folder}\n" in said
    about = json.loads((folder / "report.json").read_text())
    assert about["report"]["command"] == "python scripts/report.py 'from=docs/results/own name' baseline=td3"
    shutil.copytree(folder, tmp_path / "theirs")
    again, _ = report(tmp_path, "from=theirs", "baseline=td3", "report.formats=[]")
    ours, theirs = (json.loads((one / "reports" / "one" / "report.json").read_text()) for one in (output_dir, tmp_path))
    assert set(differences(ours, theirs)) <= AT_A_PLACE
    assert theirs["command"] == f"python scripts/report.py from=theirs baseline=td3 output_dir={tmp_path}"
    assert theirs["provenance"]["uri"] == "theirs"
    lines = said.splitlines()
    assert again.splitlines()[:-1] == [line for line in lines[:-1] if not line.startswith("export")]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["reports", "theirs"]
    assert (tmp_path / "reports" / "one" / "index.html").exists()
    tables = [
        sorted(path.name for path in (one / "reports" / "one" / "tables").iterdir()) for one in (output_dir, tmp_path)
    ]
    assert tables[0] == tables[1]


def plain_look(label, seed):
    return Look(success=0.8 if label == "sac" else 0.2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["from=ex", "experiment=one"], ["experiment", "from=ex"]),
        (["from=ex", "tracking.uri=sqlite:///x.db"], ["tracking.uri", "from=ex"]),
        (["from=ex", "export=other"], ["export", "from=ex"]),
        (["from=2024"], ["2024"]),
        (["frm=ex"], ["frm", "'from'"]),
        (["exprot=ex"], ["exprot", "'export'"]),
        (["experiment=one", "export=full"], ["export=", "full", "notes.txt"]),
    ],
)
def test_a_mistake_names_the_key_and_writes_nothing(tmp_path, arguments, words):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    _, said = report(tmp_path, *arguments, code=2)
    assert said.startswith("error: ")
    assert all(word in said for word in words)
    assert [path.name for path in tmp_path.iterdir()] == ["full"]

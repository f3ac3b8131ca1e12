"""`scripts/report.py`."""

import json
import re

import pytest
import yaml
from support.report_command import report
from support.runs import ROOT, copy_of, run_code, store
from support.store_factory import Look, make_store

from parking_exp.cli.report import read_overrides
from parking_exp.config.compose import compose_configs
from parking_exp.errors import ConfigError
from parking_exp.reports.report_request import validate_report
from parking_exp.results import load

ALGORITHMS = {"sac": [], "td3": ["algorithm=td3"]}


def two_cells(output_dir):
    """Make an experiment of two cells with three seeds each."""
    make_store(
        output_dir,
        "one",
        ALGORITHMS,
        range(3),
        lambda label, seed: Look(0.8 if label == "sac" else 0.2),
    )
    return output_dir


@pytest.fixture
def made(output_dir):
    return two_cells(output_dir)


@pytest.fixture(scope="module")
def unchanged(empty):
    """The same, for tests that write nothing."""
    with copy_of(empty) as folder:
        yield two_cells(folder)


def stored(output_dir):
    """The numbers of a report."""
    return json.loads((output_dir / "reports" / "one" / "report.json").read_text())


def test_a_report_has_a_page_tables_figures_and_every_number(made):
    done = report(made, "experiment=one")
    folder = made / "reports" / "one"
    assert done.stdout.splitlines()[-1] == f"report         {folder / 'index.html'}"
    assert done.stdout.startswith("sac has the highest final success: 80.0 % [")
    files = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    assert files == {"figures", "index.html", "report.json", "tables"}
    names = ("final_success", "learning_curves", "pairwise", "scene_map")
    figures = {path.name for path in (folder / "figures").iterdir()}
    assert figures == {f"{name}.{ending}" for name in names for ending in ("svg", "png")}
    tables = {path.name for path in (folder / "tables").iterdir()}
    assert {"headline.csv", "headline.tex", "seeds.csv", "pairs.csv", "pairs.tex"} <= tables
    numbers = stored(made)
    assert [cell["success"]["value"] for cell in numbers["cells"]] == [
        pytest.approx(0.8),
        pytest.approx(0.2),
    ]
    assert numbers["command"] == f"python scripts/report.py experiment=one output_dir={made}"


@pytest.mark.parametrize("link", ["reports", "reports/one/tables", "reports/one/.lock"])
def test_a_report_does_not_follow_links_out_of_the_output_directory(made, tmp_path_factory, link):
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (elsewhere / "index.html").write_text("mine")
    path = made / link
    target = elsewhere / "file" if link.endswith(".lock") else elsewhere
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(target)
    folder = made if link.count("/") < 2 else made / "reports" / "one"
    done = report(made, "experiment=one", code=2)
    assert (
        done.stderr == f"error: {path} is a symbolic link that leads out of {folder}; remove it\n"
    )
    assert [file.name for file in elsewhere.iterdir()] == ["index.html"]


def test_torch_the_simulators_and_optuna_are_not_imported(made):
    code = (
        "import sys; sys.argv = ['report.py', 'experiment=one', *sys.argv[1:]]\n"
        "from parking_exp.cli.report import main; main()\n"
        "heavy = {'torch', 'gymnasium', 'highway_env', 'stable_baselines3', 'optuna'}\n"
        "print([*heavy & {*sys.modules}])"
    )
    done = run_code(code, f"output_dir={made}", "report.formats=[]", cwd=ROOT)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.slow
def test_a_new_report_replaces_the_files_of_the_last_one_and_keeps_other_files(made):
    report(made, "experiment=one")
    folder = made / "reports" / "one"
    (folder / "notes.txt").write_text("mine")
    done = report(made, "experiment=one", "td3")
    assert done.stdout.startswith("td3 succeeds in 20.0 % [")
    assert (folder / "notes.txt").read_text() == "mine"
    assert not list((folder / "figures").glob("pairwise.*"))
    assert not list((folder / "tables").glob("pairs.*"))
    assert stored(made)["provenance"]["left_out"] == ["sac"]


@pytest.fixture(scope="module")
def behind(empty):
    """(printed, output directory, runs) of a quick report whose store has not all that the run
    directories have.
    """

    def look(label, seed):
        return Look(status="done" if label == "sac" and seed != 2 else "running")

    with copy_of(empty) as folder:
        runs = make_store(folder, "one", ALGORITHMS, range(4), look)
        for seed in (1, 3):
            runs["sac", seed].update_status(status="failed", error="it was killed")
        (runs["sac", 3].path / "config.yaml").write_text("no config")
        assert set(load("one", output_dir=folder).runs["status"]) == {"done", "running"}
        yield report(folder, "experiment=one", "report=quick"), folder, runs


def test_a_quick_report_shows_finished_runs_and_counts_missing_ones(behind):
    done, output_dir, _ = behind
    assert "Runs done: 2 of 8; 1 failed, 5 interrupted or not started." in done.stdout
    assert "No run is done of td3." in done.stdout
    folder = output_dir / "reports" / "one"
    assert {path.suffix for path in (folder / "figures").iterdir()} == {".png"}
    assert "Runs done: 2 of 8" in (folder / "index.html").read_text()


def test_a_report_sends_what_the_store_lacks_and_reads_it_there(behind):
    done, output_dir, runs = behind
    sac = load("one", output_dir=output_dir).runs["status"].tolist()[:4]
    assert sac == ["done", "failed", "interrupted", "done"]
    assert str(runs["sac", 3].path) in done.stderr  # it can't be sent
    assert stored(output_dir)["cells"][0]["counts"] == {
        "done": 2,
        "running": 0,
        "failed": 1,
        "pending": 1,
    }
    failed, interrupted, *_ = stored(output_dir)["provenance"]["unfinished"]
    assert (failed["seed"], failed["status"], failed["reason"]) == (1, "failed", "it was killed")
    assert (interrupted["seed"], interrupted["status"]) == (2, "interrupted")


def test_hostile_names_are_text_everywhere(output_dir):
    hostile = "<script>window.pwned=1</script>"
    tags = {"cpu": hostile, "mlflow.runName": hostile, "cell": f"x{hostile}-a"}
    make_store(output_dir, "one", {"a": []}, range(2), lambda *_: Look(tags=tags))
    for path in output_dir.glob("mlflow-artifacts/one/*/artifacts/config.yaml"):
        config = yaml.safe_load(path.read_text())
        config["algorithm"]["name"] = "\x1b[2J\x9b31m\u202e\nerror: x"
        del config["tracking"]  # makes room: a file of another size would be sent again
        path.write_text(yaml.safe_dump(config).ljust(path.stat().st_size, "\n"))
    done = report(output_dir, "experiment=one")
    assert all(line.isprintable() for line in (done.stdout + done.stderr).split("\n"))
    assert done.stdout.startswith(
        r"“\x1b[2J\x9b31m\u202e\nerror: x, her_future” succeeds in 80.0 % ["
    )
    folder = output_dir / "reports" / "one"
    page = (folder / "index.html").read_text()
    assert hostile not in page
    assert "&lt;script&gt;window.pwned=1&lt;/script&gt;" in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["experiment=on"],
            r"experiment=on: there is no such experiment in sqlite:///.*; did you mean 'one'\?",
        ),
        (["experiment=one", "td4"], r"cells: no cell is called 'td4'; did you mean 'td3'\?"),
        (["basline=td3"], "basline: there is no such key; did you mean 'baseline'"),
        (["trackng.uri=x"], "trackng.uri: there is no such key; did you mean 'tracking.uri'"),
        (
            ["experiment=one", "contrast=algorithm:sac-td4"],
            "no cell has 'algorithm=td4'; did you mean 'algorithm=td3'",
        ),
        (
            ["experiment=one", "contrast=sac-td3"],
            "contrast=sac-td3: write a factor and two of its levels, e.g. contrast=b",
        ),
        (
            ["contrast=algorithm:sac-td3", "baseline=sac"],
            "contrast: cannot be combined with baseline=sac",
        ),
        (
            ["experiment=one", "report=quik"],
            r"report=quik: there is no such option; did you mean 'quick'\?",
        ),
        (["experiment=one", "tracking.uri=sqlite:///nowhere.db"], "there is no store .*nowhere.db"),
    ],
)
def test_a_mistake_is_a_sentence_and_nothing_is_written(unchanged, arguments, words):
    files = sorted(unchanged.iterdir())
    done = report(unchanged, *arguments, code=2)
    assert re.search(words, done.stderr), done.stderr
    assert sorted(unchanged.iterdir()) == files


@pytest.mark.parametrize("words", ["my_own=3", "algorithm.gama=1", "her_final, gamma=1"])
def test_keys_that_a_runs_own_class_may_have_are_looked_up_in_the_store(tmp_path, words):
    assert re.match(r"error: there is no store .*mlflow.db", report(tmp_path, words, code=2).stderr)


def test_words_without_a_key_of_the_command_name_cells():
    words = [
        "experiment=[a, b]",
        "her_*",
        "buffer.n_sampled_goal=1,4",
        "baseline=x, y=1",
        "contrast=a:b-c d",
        "report=quick",
    ]
    assert read_overrides(words) == [
        "experiment_name=['a','b']",
        "baseline='x, y=1'",
        "contrast='a:b-c d'",
        "report=quick",
        "cells=['her_*','buffer.n_sampled_goal=1,4']",
    ]
    with pytest.raises(ConfigError, match=r"name cells either as words or as cells=\[...\]"):
        read_overrides(["her", "cells=[x]"])


@pytest.mark.parametrize(
    "words", [["0.10", "1e-3"], ["0.10,1e-3"], ["cells=0.10,1e-3"], ["cells=[0.10,1e-3]"]]
)
def test_labels_that_look_like_numbers_select_cells_as_text(words):
    (config,) = compose_configs("report", read_overrides(["experiment=a", "baseline=0.10", *words]))
    request = validate_report(config)
    assert (request.cells_asked, request.baseline) == (["0.10", "1e-3"], "0.10")


def test_the_report_of_an_experiment_renamed_to_a_path_stays_in_the_output_directory(made):
    client, name = store(made), "../../elsewhere"
    client.rename_experiment(client.get_experiment_by_name("one").experiment_id, name)
    report(made, f"experiment={name}", "report=quick")
    (folder,) = (made / "reports").iterdir()
    assert (folder / "index.html").exists()
    assert "/" not in folder.name
    assert not (made.parent / "elsewhere").exists()


def test_an_experiment_has_to_be_named_if_there_are_several(made):
    make_store(made, "two", {"sac": []}, [0])
    assert (
        report(made, code=2).stderr
        == "error: experiment: the store has several; name one or more of one, two\n"
    )


def test_a_store_given_by_its_uri_is_only_read(output_dir, tmp_path):
    uri = f"sqlite:///{output_dir}/mlflow.db"
    runs = make_store(tmp_path, "one", {"sac": []}, range(2), uri=uri)
    runs["sac", 1].update_status(status="failed", error="it was killed")
    before = (output_dir / "mlflow.db").read_bytes()
    report(tmp_path, "experiment=one", "report=quick", f"tracking.uri={uri}")
    assert (output_dir / "mlflow.db").read_bytes() == before
    assert stored(tmp_path)["cells"][0]["counts"] == {
        "done": 2,
        "running": 0,
        "failed": 0,
        "pending": 0,
    }

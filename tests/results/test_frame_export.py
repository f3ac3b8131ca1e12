"""An export has what a report needs of a store's frames, in small files that name no machine."""

import errno
import gzip
import json
import math
import re
from dataclasses import replace

import pandas as pd
import pytest
from support.runs import copy_of, names_in, read_text, smoke_config
from support.store_factory import Look, make_store

from parking_exp.config.settings import decode_setting, encode_setting
from parking_exp.errors import ConfigError, ResultsError
from parking_exp.results import load, read_export, write_export
from parking_exp.results.frame_export import FILES, LOCAL_COLUMNS, without_paths

HER = {"four": ["buffer.n_sampled_goal=4"], "none": ["buffer=replay"]}
HOSTILE = 'a,b "c"\nd\re <script>'
LOOKS = {
    ("four", 0): Look(
        success=2 / 3, crash=0.2, parked=0.4, curve=(0.0, 1 / 3, 1.0), cpu_s=1234.56789
    ),
    ("four", 1): Look(
        status="failed", error="no file /home/some.one/data/x.zip: (see sqlite:////tmp/r/mlflow.db)"
    ),
    ("none", 0): Look(
        success=1.0,
        crash=0.0,
        tags={"cpu": "Zürich 学習", "git_dirty": None},
        nan=["eval/return_mean"],
    ),
    ("none", 1): Look(status="running"),
}
SETTINGS = {
    "four": {
        "list": [1, 2],
        "mixed": "word",
        "whole": 3,
        "flag": True,
        "text": HOSTILE,
        "path": "/home/me/own",
    },
    "none": {
        "list": [1, 2],
        "mixed": 0.5,
        "null": None,
        "number": 0.1234567891,
        "huge": int("9" * 30),
        "empty": "",
    },
}


@pytest.fixture(scope="module")
def stored(empty):
    """Results of two cells with a done and another run each."""
    with copy_of(empty) as folder:
        looks = {key: replace(look, settings=SETTINGS[key[0]]) for key, look in LOOKS.items()}
        make_store(folder, "her", HER, range(2), lambda *key: looks[key])
        yield load("her", output_dir=folder)


@pytest.fixture
def written(stored, tmp_path):
    """The folder of their export."""
    return write_export(stored, tmp_path / "docs" / "her")


def edit(path, old, new):
    text = read_text(path)
    assert old in text
    content = text.replace(old, new, 1).encode()
    path.write_bytes(gzip.compress(content) if path.suffix == ".gz" else content)


def test_an_export_has_no_metrics_of_other_tasks_and_reading_gives_their_columns_back(
    stored, tmp_path
):
    of_parking = ["crash_rate", "parked_rate"]
    own = replace(
        stored,
        runs=stored.runs.assign(
            failure_rate=stored.runs["crash_rate"],
            crash_rate=float("nan"),
            parked_rate=float("nan"),
        ),
        curves=stored.curves.assign(crash_rate=float("nan"), parked_rate=float("nan")),
    )
    for results, absent, present in (
        (stored, ["failure_rate"], of_parking),
        (own, of_parking, ["success_rate"]),
    ):
        folder = write_export(results, tmp_path / present[0])
        for name in ("runs.csv.gz", "curves.csv.gz"):
            columns = [*pd.read_csv(folder / name)]
            assert [column for column in columns if column in absent] == []
            assert [column for column in present if column not in columns] == []
        frames = read_export(folder)
        assert frames.runs[absent].isna().all(axis=None)
        assert frames.curves[absent].isna().all(axis=None)


def test_runs_come_back_with_their_types_and_without_places(stored, written):
    runs = read_export(written).runs
    places = [name for name in LOCAL_COLUMNS if name in stored.runs]
    assert places == list(LOCAL_COLUMNS)
    assert runs[["run_dir", "artifact_uri"]].isna().all(axis=None)
    assert not {"config.output_dir", "config.tracking.uri"} & {*runs}
    texts = [
        "error",
        "config.x.path",
        "config.x.empty",
    ]  # paths are cut, and an empty text is missing
    pd.testing.assert_frame_equal(
        runs.drop(columns=["run_dir", "artifact_uri", *texts]),
        stored.runs.drop(columns=[*places, *texts]),
        rtol=1e-11,
    )
    assert runs["config.x.whole"].tolist() == [3, 3, None, None]
    assert runs["config.x.flag"].tolist() == [True, True, None, None]
    assert runs["config.x.text"][0] == HOSTILE
    assert runs["config.x.number"].max() == 0.1234567891
    assert runs["config.x.huge"][2] == int("9" * 30)
    assert runs["cpu_s"][0] == 1234.56789


def test_curves_and_outcomes_come_back_rounded_to_six_digits(stored, written):
    results = read_export(written)
    pd.testing.assert_frame_equal(results.curves, stored.curves, rtol=1e-5)
    run = results.curves[results.curves["run_id"] == stored.runs["run_id"][0]]
    assert run["success_rate"].tolist() == [0.0, 0.333333, 1.0]
    assert run["cpu_s"].tolist() == [410.494, 824.074, 1234.57]
    final = stored.episodes[stored.episodes["phase"] == "final"].reset_index(drop=True)
    exported = ["run_id", "phase", "step", "scene", "outcome"]
    pd.testing.assert_frame_equal(results.episodes[exported], final[exported])
    assert list(results.episodes) == list(final)
    assert results.episodes[["parked", "steps", "return"]].isna().all(axis=None)


def test_problems_are_kept_and_the_folder_is_the_source(stored, tmp_path):
    reported = replace(stored, problems=("a: /tmp/x/y.csv is missing", "b"))
    results = read_export(write_export(reported, tmp_path / "one"))
    assert results.problems == ("a: y.csv is missing", "b")
    assert results.uri == str(tmp_path / "one")


def test_the_same_results_give_the_same_bytes_and_replace_an_earlier_export(stored, written):
    before = {path.name: path.read_bytes() for path in written.iterdir()}
    assert set(before) == set(FILES)
    write_export(replace(stored, problems=("a",)), written)
    assert json.loads((written / "report.json").read_text())["problems"] == ["a"]
    write_export(stored, written)
    assert {path.name: path.read_bytes() for path in written.iterdir()} == before
    assert names_in(written.parent) == ["her"]


def test_no_file_of_an_export_names_a_place_on_the_machine(stored, written):
    text = "".join(read_text(path) for path in written.iterdir())
    assert not re.search(r"/(home|tmp|dev|root|work)\b|sqlite:|file:", text)
    assert read_export(written).runs["error"][1] == "no file x.zip: (see mlflow.db)"
    assert read_export(written).runs["config.x.path"][0] == "own"
    unchanged = "cpu 5 km/h, a/b and 1 / 2 of http://host:5000/x"
    assert without_paths(f"{unchanged}, ['/a/b', '/c']") == f"{unchanged}, ['b', 'c']"


def test_a_folder_with_other_files_is_refused_and_left_alone(stored, tmp_path):
    (tmp_path / "notes.txt").write_text("content")
    with pytest.raises(
        ConfigError, match=r"it holds other files, e\.g\. notes\.txt; name a folder of its own"
    ):
        write_export(stored, tmp_path)
    assert names_in(tmp_path) == ["notes.txt"]
    with pytest.raises(ConfigError, match="is a file; name a folder"):
        write_export(stored, tmp_path / "notes.txt")


def test_an_export_that_was_interrupted_is_not_whole(stored, written, monkeypatch):
    def full(*arguments, **keywords):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched, pytest.raises(OSError, match="No space left"):
        patched.setattr(pd.DataFrame, "to_csv", full)
        write_export(stored, written)
    with pytest.raises(ResultsError, match=r"is not a whole export: it has no report\.json"):
        read_export(written)


def test_an_export_does_not_write_through_links(stored, written, tmp_path):
    other = tmp_path / "other.csv"
    other.write_text("content")
    (written / "runs.csv.gz").unlink()
    (written / "runs.csv.gz").symlink_to(other)
    write_export(stored, written)
    assert other.read_text() == "content"
    assert len(read_export(written).runs) == 4


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("report.json", '"problems"', '"problem"'),
        ("report.json", "{", "["),
        ("runs.csv.gz", "run_id,", "run,"),
        ("runs.csv.gz", ",200,", ",200.5,"),
        ("runs.csv.gz", "2023-11-14 ", "2023-99-14 "),
        ("curves.csv.gz", ",0.333333", ",a"),
        ("outcomes.csv.gz", "scene", "scenes"),
    ],
)
def test_a_damaged_export_is_refused_in_one_sentence(written, name, old, new):
    edit(written / name, old, new)
    with pytest.raises(ResultsError, match="can't be read") as error:
        read_export(written)
    assert str(written) in str(error.value)
    assert "\n" not in str(error.value)


def test_rows_of_runs_that_an_export_does_not_have_are_left_out(written):
    edit(written / "curves.csv.gz", "\n", "\nx")
    edit(written / "outcomes.csv.gz", "scene,", "scene,x")
    results = read_export(written)
    assert set(results.curves["run_id"]) | set(results.episodes["run_id"]) <= set(
        results.runs["run_id"]
    )


def test_places_that_the_export_of_someone_else_names_are_not_read(written):
    runs = pd.read_csv(written / "runs.csv.gz", dtype=str)
    runs.assign(run_dir="/etc", artifact_uri="/etc").to_csv(written / "runs.csv.gz", index=False)
    assert read_export(written).runs[["run_dir", "artifact_uri"]].isna().all(axis=None)


LABELS = ["0.10", "1e-3", "True", "None", "nan", "2024_11", '"quoted"', "her /no noise", "a/b /c d"]


def test_labels_and_words_that_look_like_numbers_stay_text_in_stores_and_exports(
    output_dir, tmp_path
):
    contrasts = [["her /no noise", "0.10"]]
    cells = {
        label: smoke_config().model_copy(
            update={"label": label, "contrasts": contrasts, "torch_threads": number}
        )
        for number, label in enumerate(LABELS, 1)
    }
    words = {label: {"word": label, "number": 0.1} for label in LABELS}
    named = {f"{number}": config for number, config in enumerate(cells.values())}
    make_store(output_dir, "e", named, [0], lambda name, _: Look(settings=words[LABELS[int(name)]]))
    stored = load("e", output_dir=output_dir)
    exported = read_export(write_export(stored, tmp_path / "export"))
    for results in (stored, exported):
        assert set(results.runs["config.label"]) == set(LABELS)
        assert set(results.runs["config.contrasts"]) == {str(contrasts)}
        assert set(results.runs["config.x.number"]) == {0.1}
    assert set(stored.runs["config.x.word"]) == set(LABELS)


@pytest.mark.parametrize(
    "value",
    [
        None,
        True,
        3,
        -0.5,
        1e-300,
        math.inf,
        "",
        "word",
        "3",
        "[1, 2]",
        '"',
        '"3"',
        "None",
        "é",
        "2024_11",
    ],
)
def test_settings_come_back_from_text(value):
    assert decode_setting(encode_setting(value)) == value
    assert type(decode_setting(encode_setting(value))) is type(value)

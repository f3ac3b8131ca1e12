"""Frames have what the store has, and say what it lacks."""

import json
import math
import re
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from support.mlflow_servers import closed_port, mlflow_server, needs_server
from support.runs import ROOT, in_memory, store
from support.store_factory import STARTED_MS, Look, compose, made_episodes, made_trajectories, make_store

import parking_exp.results
from parking_exp.config.paths import default_uri
from parking_exp.errors import ResultsError
from parking_exp.evaluation.metrics import EPISODE_COLUMNS
from parking_exp.results import frames, load
from parking_exp.results.recordings import CURVE, CURVE_TYPES, EPISODES

HER = {"four": ["buffer.n_sampled_goal=4"], "none": ["buffer=replay"]}
LOOKS = {
    ("four", 0): Look(success=0.8, crash=0.2, parked=0.4, curve=(0.0, 1 / 3, 1.0), steps=12, cpu_s=90.0),
    ("four", 1): Look(success=0.4, crash=0.2, parked=0.0, curve=(0.0, 0.0, 2 / 3, 1.0)),
    ("four", 2): Look(status="failed", error="ValueError: <b>\n  no", progress=0.5, curve=(0, 0.5, 1, 1)),
    ("none", 0): Look(success=1.0, crash=0.0, started_ms=STARTED_MS + 5000, tags={"cpu": "Zürich <script>alert(1)</script>"}),
    ("none", 1): Look(status="running", progress=0.5),
    ("none", 2): Look(status="interrupted", progress=0.0),
}  # fmt: skip


@pytest.fixture(scope="module")
def ablation(empty):
    """(output directory, run directories) of two cells with three seeds."""
    with in_memory() as folder:
        shutil.copy(empty / "mlflow.db", folder)
        yield Path(folder), make_store(Path(folder), "her", HER, range(3), lambda *key: LOOKS[key])


def row(runs, directory):
    """The row of a run directory."""
    (found,) = runs[runs["run_id"] == directory.run_id].to_dict("records")
    return found


def test_a_finished_run_has_the_numbers_of_its_final_evaluation(ablation):
    output_dir, made = ablation
    directory = made["four", 0]
    table = made_episodes(LOOKS["four", 0], 0.8, range(5), 0)
    found = row(load("her", output_dir=output_dir).runs, directory)
    config = directory.config()
    expected = {
        "run_id": directory.run_id, "name": f"{config.cell}-seed=0", "experiment": "her", "cell": config.cell, "seed": 0,
        "run_key": config.run_key, "status": "done", "total_timesteps": 400, "n_scenes": 5, "first_scene": 0,
        "eval_n_scenes": 3, "steps": 400, "success_rate": 0.8, "crash_rate": 0.2, "timeout_rate": 0.0, "parked_rate": 0.4,
        "episode_steps": table["steps"].mean(), "episode_return": table["return"].mean(),
        "distance_m": table["distance_m"].mean(), "heading_error_rad": table["heading_error_rad"].mean(),
        "speed_mps": table["speed_mps"].mean(), "cpu_s": 90.0, "wall_s": 600.0,
        "started": pd.Timestamp(STARTED_MS, unit="ms", tz="UTC"), "run_dir": str(directory.path), "config.seed": 0,
    }  # fmt: skip
    assert {name: found[name] for name in expected} == expected
    assert pd.isna(found["error"])
    assert found["artifact_uri"].endswith(f"/mlflow-artifacts/her/{directory.run_id}/artifacts")
    assert found["started"] < found["ended"]


def test_frames_have_the_columns_and_types_of_the_schema(ablation):
    found = load("her", output_dir=ablation[0])
    assert [*found.runs.columns[: len(frames.RUN_TYPES)]] == [*frames.RUN_TYPES]
    others = [name for name in found.runs.columns if name not in frames.RUN_TYPES]
    assert all(name.startswith(("version.", "config.")) for name in others)
    assert [*found.curves.columns] == [*CURVE_TYPES]
    assert [*found.episodes.columns] == ["run_id", *EPISODES]
    assert ["phase", "step", *EPISODE_COLUMNS] == list(EPISODES)
    types = {name: str(dtype) for name, dtype in found.runs.dtypes.items()}
    integers = ("total_timesteps", "n_scenes", "first_scene", "eval_n_scenes")
    numbers = ("success_rate", "episode_steps", "cpu_s", "wall_s", "speed_mps")
    assert {types[name] for name in integers} == {"Int64"}
    assert {types[name] for name in numbers} == {"float64"}
    assert (types["seed"], types["steps"], types["status"], types["git_dirty"]) == (
        "int64",
        "int64",
        "category",
        "boolean",
    )
    assert types["started"] == types["ended"] == "datetime64[ms, UTC]"
    assert {types[name] for name in ("run_id", "error", "cell", "run_dir", "version.torch")} == {"str"}
    assert [str(dtype) for dtype in found.curves.dtypes] == ["str", "int64"] + 8 * ["float64"]
    assert [str(found.episodes[name].dtype) for name in ("run_id", "phase", "outcome", "parked", "steps", "return")] == [
        "category", "category", "category", "bool", "int64", "float64"]  # fmt: skip
    documented = parking_exp.results.__doc__
    for name in (*frames.RUN_TYPES, *CURVE_TYPES, *EPISODES):
        assert re.search(rf"\b{name}\b", documented), name


def test_config_columns_are_typed_and_what_a_cell_does_not_have_is_missing(ablation):
    output_dir, made = ablation
    runs = load("her", output_dir=output_dir).runs.set_index("run_id")
    four, none = made["four", 0].run_id, made["none", 0].run_id
    assert runs.at[four, "config.buffer.n_sampled_goal"] == 4
    assert runs.at[none, "config.buffer.n_sampled_goal"] is None
    assert str(runs["config.algorithm.tau"].dtype) == "float64"
    assert runs.at[four, "config.algorithm.tau"] == compose().algorithm.arguments["tau"]
    assert str(runs["config.env.add_walls"].dtype) == "bool"
    assert runs.at[four, "config.algorithm.net_arch"] == "[16, 16]"
    assert runs["config.timeout_s"].isna().all()


PARAMS = [("3", 3), ("5e-05", 5e-05), ("inf", math.inf), ("True", True), ("None", None), (None, None), ("auto", "auto"),
          ("[1, 2]", "[1, 2]"), ("", ""), ("1.2.3", "1.2.3")]  # fmt: skip


@pytest.mark.parametrize(("text", "value"), PARAMS)
def test_a_parameter_has_the_value_that_was_logged(text, value):
    assert frames.typed(text) == value
    assert type(frames.typed(text)) is type(value)


def test_damaged_and_odd_artifacts_spoil_nothing_else(output_dir):
    header = "phase,step,scene,outcome,parked,steps,return,distance_m,heading_error_rad,speed_mps\n"
    line = "certified,400,0,success,True,9,-1.5,0.1,0.01,0.2\n"
    contents = {1: "no table", 2: "", 3: header + line[:20], 4: header + line.replace("success", "glory"),
                5: header + line.replace("9", "nine"), 6: header.replace("scene", "start") + line,
                7: header + "a,b\n", 8: header + line.replace("0,success", "-1,success"),
                11: f"note,{header}x,{line}", 13: "phase,step,scene,outcome\ncertified,400,0,success\n"}  # fmt: skip
    looks = {
        **{seed: Look(contents={"episodes.csv": text.encode()}) for seed, text in contents.items()},
        0: Look(nan=["eval/success_rate", "final/success_rate"]),
        9: Look(missing=["episodes.csv"]),
        10: Look(contents={"episodes.csv": b"\xff\xfe\n"}),
        12: Look(status="failed", error="e", progress=0.0),
    }
    made = make_store(output_dir, "e", {"": []}, sorted(looks), lambda _, seed: looks[seed])
    found = load("e", output_dir=output_dir)
    assert len(found.runs) == len(looks)
    readable = [made["", seed].run_id for seed in (0, 11, 13)]
    assert sorted(found.episodes["run_id"].unique()) == sorted(readable)
    (odd,) = found.episodes[found.episodes["run_id"] == readable[1]].to_dict("records")
    assert (odd["phase"], odd["outcome"], odd["steps"], odd["return"]) == ("certified", "success", 9, -1.5)
    lacking = found.episodes[found.episodes["run_id"] == readable[2]]  # made before these metrics were added
    assert lacking[["parked", "steps", "distance_m"]].isna().all(axis=None)
    cell = found.runs["cell"][0]
    problems = dict(
        re.fullmatch(rf"run \w+ \({cell}, seed (\d+)\): episodes\.csv (.+)", each).groups() for each in found.problems
    )
    assert list(map(int, problems)) == list(range(1, 11))
    assert "missing" in problems["9"]
    assert "scene" in problems["6"]
    run = row(found.runs, made["", 0])
    assert (run["steps"], run["crash_rate"]) == (400, 0.0)
    assert math.isnan(run["success_rate"])
    curve = found.curves[found.curves["run_id"] == made["", 0].run_id]
    assert list(curve["step"]) == [100, 200, 300, 400]
    assert curve["success_rate"].isna().all()


def test_a_curve_has_a_row_for_each_evaluation(ablation):
    output_dir, made = ablation
    curves = load("her", output_dir=output_dir).curves
    assert list(curves["run_id"]) == sorted(curves["run_id"])
    first = curves[curves["run_id"] == made["four", 0].run_id]
    assert list(first["step"]) == [133, 267, 400]
    assert list(first["success_rate"]) == pytest.approx([0, 1 / 3, 1])
    assert list(first["crash_rate"]) == pytest.approx([1 / 3, 1 / 3, 0])
    assert list(first["timeout_rate"]) == pytest.approx([2 / 3, 1 / 3, 0])
    assert list(first["cpu_s"]) == pytest.approx([90 * 133 / 400, 90 * 267 / 400, 90])
    assert list(first["real_share"]) == [0.5, 0.5, 0.5]
    assert list(curves[curves["run_id"] == made["four", 1].run_id]["step"]) == [100, 200, 300, 400]
    assert made["none", 2].run_id not in set(curves["run_id"])


def test_runs_that_are_not_done_have_what_they_came_to_and_no_final_numbers(ablation):
    output_dir, made = ablation
    found = load("her", output_dir=output_dir)
    unfinished = [row(found.runs, made[key]) for key in (("four", 2), ("none", 1), ("none", 2))]
    assert [run["status"] for run in unfinished] == ["failed", "running", "interrupted"]
    assert [run["steps"] for run in unfinished] == [200, 200, 0]
    assert [run["cpu_s"] for run in unfinished][:2] == [150.0, 150.0]
    assert all(math.isnan(run[name]) for run in unfinished for name in frames.FINAL.values())
    assert unfinished[0]["error"] == "ValueError: <b> no"
    assert [pd.isna(run["error"]) for run in unfinished] == [False, True, True]
    assert [pd.isna(run["ended"]) for run in unfinished] == [False, True, False]
    counts = found.episodes["run_id"].value_counts()
    assert [counts[made[key].run_id] for key in (("four", 2), ("none", 1), ("none", 2))] == [2 * 3, 0, 0]
    assert found.problems == ()


def test_names_come_as_they_are(ablation, output_dir):
    output_dir_, made = ablation
    assert row(load("her", output_dir=output_dir_).runs, made["none", 0])["cpu"] == "Zürich <script>alert(1)</script>"
    evil = "<img src=x onerror=alert(1)> 東京"
    look = Look(tags={"cell": evil, "mlflow.runName": evil}, params={"note": evil, "env.other": "1e400"})
    (directory,) = make_store(output_dir, "e", {"": []}, [0], lambda *_: look).values()
    found = row(load("e", output_dir=output_dir).runs, directory)
    assert (found["cell"], found["name"], found["config.note"]) == (evil, evil, evil)
    assert found["config.env.other"] == math.inf


def test_runs_of_others_and_deleted_ones_are_left_out(output_dir):
    made = make_store(output_dir, "e", {"": []}, range(2))
    client = store(output_dir)
    experiment_id = client.get_experiment_by_name("e").experiment_id
    client.create_run(experiment_id, run_name="by hand")
    odd = {"cell": "c", "seed": "one", "run_key": "k", "run_dir": "d", "status": "done"}
    client.create_run(experiment_id, tags=odd)
    client.delete_run(made["", 1].run_id)
    found = load("e", output_dir=output_dir)
    assert list(found.runs["run_id"]) == [made["", 0].run_id]
    assert set(found.curves["run_id"]) == set(found.runs["run_id"]) == set(found.episodes["run_id"])
    assert found.ignored == 2


def test_a_run_that_is_there_twice_is_said(output_dir, tmp_path):
    make_store(output_dir, "e", {"": []}, [0])
    (twin,) = make_store(tmp_path, "e", {"": []}, [0], uri=default_uri(output_dir)).values()
    found = load("e", output_dir=output_dir)
    assert len(found.runs) == 2
    assert found.problems == (f"e, {twin.config().cell}, seed 0: 2 runs have it",)


def test_trajectories_are_those_that_were_recorded(ablation):
    output_dir, made = ablation
    found = load("her", output_dir=output_dir)
    ways = found.trajectories(made["four", 0].run_id)
    recorded = made_trajectories(made_episodes(LOOKS["four", 0], 0.8, range(5), 0))
    assert [str(dtype) for dtype in ways.dtypes] == ["int64", "int64"] + 4 * ["float32"]
    assert list(ways.columns) == ["scene", "step", "x_m", "y_m", "heading_rad", "speed_mps"]
    assert list(ways.groupby("scene").size()) == list(recorded["length"])
    second = ways[ways["scene"] == 1]
    assert list(second["step"]) == list(range(recorded["length"][1]))
    for name in ("x_m", "y_m", "heading_rad", "speed_mps"):
        np.testing.assert_array_equal(ways[name], recorded[name])
    for key in (("none", 1), ("four", 2)):
        empty = found.trajectories(made[key].run_id)
        assert (len(empty), list(empty.dtypes)) == (0, list(ways.dtypes))


def test_trajectories_that_cannot_be_had_are_said(output_dir, tmp_path):
    short, hidden = tmp_path / "short.npz", tmp_path / "hidden.npz"
    arrays = {
        "scene": np.arange(2),
        "length": np.array([2, 3]),
        **dict.fromkeys(("x_m", "y_m", "heading_rad", "speed_mps"), np.zeros(5)),
    }
    np.savez(short, **{**arrays, "x_m": np.zeros(4)})
    np.savez(hidden, **{**arrays, "x_m": np.array([print] * 5, dtype=object)})
    contents = [b"no zip", b"", short.read_bytes(), hidden.read_bytes(), short.read_bytes()[:300]]
    looks = [Look(contents={"trajectories.npz": content}, trajectories=0) for content in contents]
    make_store(output_dir, "e", {"": []}, range(5), lambda _, seed: looks[seed])
    found = load("e", output_dir=output_dir)
    for run_id in found.runs["run_id"]:
        with pytest.raises(ResultsError, match=rf"^run {run_id}: trajectories.npz can't be read: "):
            found.trajectories(run_id)
    with pytest.raises(ResultsError, match=r"^run_id=x: it is none of 5 runs; choose from "):
        found.trajectories("x")


def test_a_store_that_is_not_there_is_not_made(tmp_path):
    path = tmp_path / "outputs" / "mlflow.db"
    with pytest.raises(ResultsError) as raised:
        load("her", output_dir=tmp_path / "outputs")
    assert str(raised.value) == f"there is no store {path}; train something first, or name another output_dir or store"
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_store_is_said_in_a_sentence(tmp_path):
    file = tmp_path / "mlflow.db"
    file.write_text("this is not a database, and it is long enough to be looked at " * 20)
    with pytest.raises(ResultsError) as raised:
        load("her", output_dir=tmp_path)
    assert str(raised.value) == f"the store sqlite:///{file} can't be read: file is not a database"
    with closed_port() as port, pytest.raises(ResultsError) as raised:
        load("her", uri=f"http://me:secret@127.0.0.1:{port}")
    assert str(raised.value) == f"the store http://me@127.0.0.1:{port} can't be read: Connection refused"


def test_an_unknown_experiment_is_said_with_what_there_is(ablation):
    uri = default_uri(ablation[0])
    with pytest.raises(ResultsError) as raised:
        load("hers", uri=uri)
    assert str(raised.value) == f"experiment=hers: {uri} has none of that name; did you mean 'her'?"
    with pytest.raises(ResultsError, match=r"experiment=zzz: .* has none of that name; choose from her$"):
        load(["her", "zzz"], uri=uri)


def test_an_experiment_without_runs_is_said(output_dir):
    client = store(output_dir)
    client.create_run(client.create_experiment("void"))
    with pytest.raises(ResultsError, match=r"^experiment=void: .*, but 1 by others$"):
        load("void", output_dir=output_dir)


def test_reading_changes_nothing_in_the_store(ablation):
    def content():
        with closing(sqlite3.connect(ablation[0] / "mlflow.db")) as database:
            return list(database.iterdump())

    before = content()
    found = load("her", output_dir=ablation[0])
    found.trajectories(found.runs["run_id"][0])
    assert content() == before


@pytest.mark.slow
def test_results_are_read_without_torch_and_simulators(ablation):
    code = (
        "import sys; from parking_exp.results import load; found = load('her', output_dir=sys.argv[1]); "
        "found.trajectories(found.runs['run_id'][0]); "
        "print(sorted({'torch', 'gymnasium', 'highway_env', 'stable_baselines3', 'matplotlib'} & set(sys.modules)))"
    )
    command = [sys.executable, "-c", code, str(ablation[0])]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120, cwd=ROOT)
    assert (done.stdout, done.returncode) == ("[]\n", 0), done.stderr


def test_a_real_run_is_loaded_as_it_was_trained(smoke):
    directory, _, output_dir = smoke
    found = load("smoke", output_dir=output_dir)
    metrics = {}
    for line in (directory.path / "metrics.jsonl").read_text().splitlines():
        record = json.loads(line)
        for key, value in record["metrics"].items():
            metrics.setdefault(key, {})[record["step"]] = value
    run, config = row(found.runs, directory), directory.config()
    assert (run["status"], run["seed"], run["cell"], run["steps"]) == ("done", config.seed, config.cell, 400)
    for key, name in {**frames.FINAL, **frames.COST}.items():
        assert run[name] == metrics[key][400]
    for key, name in {**CURVE, "time/cpu_s": "cpu_s"}.items():
        assert dict(zip(found.curves["step"], found.curves[name], strict=True)) == {
            step: metrics[key][step] for step in metrics["eval/success_rate"]
        }
    stored = found.episodes.drop(columns="run_id")
    pd.testing.assert_frame_equal(stored, pd.read_csv(directory.path / "episodes.csv").astype(EPISODES))
    assert run["config.total_timesteps"] == 400
    assert (found.problems, found.ignored) == ((), 0)


@needs_server
def test_a_server_gives_the_same_frames_as_an_embedded_store(tmp_path, capfd):
    looks = {**LOOKS, ("four", 1): Look(missing=["episodes.csv"]), ("none", 0): Look(nan=["eval/return_mean"])}
    make_store(tmp_path / "local", "her", HER, range(3), lambda *key: looks[key])
    local = load("her", output_dir=tmp_path / "local")
    capfd.readouterr()
    with closed_port() as port:
        pass
    with mlflow_server(port, tmp_path) as uri:
        made = make_store(tmp_path, "her", HER, range(3), lambda *key: looks[key], uri=uri)
        found = load("her", uri=uri)
        assert capfd.readouterr() == ("", "")  # no progress bars of downloads
        assert found.runs["artifact_uri"].str.startswith("mlflow-artifacts:").all()
        places = ["run_id", "run_dir", "artifact_uri", "config.output_dir", "config.tracking.uri", "ended"]
        pd.testing.assert_frame_equal(found.runs.drop(columns=places), local.runs.drop(columns=places))
        for name in ("curves", "episodes"):
            pd.testing.assert_frame_equal(by_cell_and_seed(found, name), by_cell_and_seed(local, name))
        assert [problem.partition("episodes.csv ")[2] for problem in found.problems] == ["is missing in the store"]
        assert len(found.trajectories(made["four", 0].run_id)) > 0
        assert found.trajectories(made["four", 2].run_id).empty


def by_cell_and_seed(results, name):
    """A frame in which cell and seed stand for the run."""
    known = results.runs.set_index("run_id")["cell"] + " " + results.runs.set_index("run_id")["seed"].astype(str)
    frame = getattr(results, name)
    frame = frame.assign(run_id=frame["run_id"].astype(str).map(known))
    return frame.sort_values(["run_id", "step"], kind="stable", ignore_index=True)

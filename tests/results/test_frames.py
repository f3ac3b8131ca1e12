"""Frames have what the store has, and say what it lacks."""

import gzip
import io
import re

import numpy as np
import pandas as pd
import pytest
from support.mlflow_servers import closed_port, mlflow_server, needs_server
from support.runs import copy_of, smoke_config, store
from support.store_factory import STARTED_MS, Look, make_store

import parking_exp.results
from parking_exp.config.paths import default_uri
from parking_exp.errors import ResultsError
from parking_exp.results import frames, load
from parking_exp.results.artifact_parsers import (
    CURVE_COLUMNS,
    CURVE_TYPES,
    EPISODE_TYPES,
    config_reader,
    read_episodes,
)
from parking_exp.runs.metric_logs import MetricsLog
from parking_exp.tasks.metrics import episode_columns
from parking_exp.tasks.parking.parking_metrics import METRICS

HER = {"four": ["buffer.n_sampled_goal=4"], "none": ["buffer=replay"]}
LOOKS = {
    ("four", 0): Look(
        success=0.8, crash=0.2, parked=0.4, curve=(0.0, 1 / 3, 1.0), steps=12, cpu_s=90.0
    ),
    ("four", 1): Look(success=0.4, crash=0.2, parked=0.0, curve=(0.0, 0.0, 2 / 3, 1.0)),
    ("four", 2): Look(
        status="failed", error="ValueError: <b>\n  no", progress=0.5, curve=(0, 0.5, 1, 1)
    ),
    ("none", 0): Look(
        success=1.0,
        crash=0.0,
        started_ms=STARTED_MS + 5000,
        tags={"cpu": "Zürich <script>alert(1)</script>"},
    ),
    ("none", 1): Look(status="running", progress=0.5),
    ("none", 2): Look(status="interrupted", progress=0.0),
}


@pytest.fixture(scope="module")
def ablation(empty):
    """(output directory, run directories) of two cells with three seeds."""
    with copy_of(empty) as folder:
        yield folder, make_store(folder, "her", HER, range(3), lambda *key: LOOKS[key])


def row(runs, directory):
    """The row of a run directory."""
    (run,) = runs[runs["run_id"] == directory.run_id].to_dict("records")
    return run


def test_frames_have_the_columns_and_types_of_the_schema(ablation):
    results = load("her", output_dir=ablation[0])
    assert [*results.runs.columns[: len(frames.RUN_TYPES)]] == [*frames.RUN_TYPES]
    others = [name for name in results.runs.columns if name not in frames.RUN_TYPES]
    assert all(name.startswith(("version.", "config.")) for name in others)
    assert (
        [*results.episodes.columns]
        == ["run_id", *EPISODE_TYPES]
        == ["run_id", "phase", "step", *episode_columns(METRICS)]
    )
    types = {name: str(dtype) for name, dtype in results.runs.dtypes.items()}
    expected = {
        "seed": "int64",
        "status": "category",
        "git_dirty": "boolean",
        "config.total_timesteps": "int64",
        "success_rate": "float64",
        "started": "datetime64[ms, UTC]",
        "ended": "datetime64[ms, UTC]",
        "error": "str",
        "version.torch": "str",
    }
    assert {name: types[name] for name in expected} == expected
    assert [*results.curves.columns] == [*CURVE_TYPES]
    assert [str(dtype) for dtype in results.curves.dtypes] == ["str", "int64"] + 9 * ["float64"]
    assert [
        str(results.episodes[name].dtype) for name in ("phase", "parked", "steps", "return")
    ] == ["category", "bool", "int64", "float64"]
    for name in (*frames.RUN_TYPES, *CURVE_TYPES, *EPISODE_TYPES):
        assert re.search(rf"\b{name}\b", parking_exp.results.__doc__), name


def test_config_columns_are_typed_and_what_a_cell_does_not_have_is_missing(ablation):
    output_dir, made = ablation
    runs = load("her", output_dir=output_dir).runs.set_index("run_id")
    four = made["four", 0].run_id
    none = made["none", 0].run_id
    assert runs.at[four, "config.buffer.n_sampled_goal"] == 4
    assert runs.at[none, "config.buffer.n_sampled_goal"] is None
    assert str(runs["config.algorithm.tau"].dtype) == "float64"
    assert runs.at[four, "config.algorithm.tau"] == smoke_config().algorithm.arguments["tau"]
    assert str(runs["config.env.add_walls"].dtype) == "bool"
    assert runs.at[four, "config.algorithm.net_arch"] == "[16, 16]"
    assert runs["config.timeout_s"].isna().all()


HEADER = "phase,step,scene,outcome,parked,steps,return,distance_m,heading_error_rad,speed_mps\n"
LINE = "certified,400,0,success,True,9,-1.5,0.1,0.01,0.2\n"


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe\n",
        (HEADER + LINE[:20]).encode(),
        (HEADER + LINE.replace("success", "glory")).encode(),
        (HEADER + LINE.replace("9", "nine")).encode(),
        (HEADER + LINE.replace("0,success", "-1,success")).encode(),
        (HEADER.replace("scene", "start") + LINE).encode(),
    ],
)
def test_episodes_that_are_damaged_are_refused(content):
    with pytest.raises(ValueError):
        read_episodes(content)


def test_episodes_have_their_columns_and_numbers_of_metrics_of_users():
    few = read_episodes(b"phase,step,scene,outcome\ncertified,400,0,success\n")
    assert [*few] == ["phase", "step", "scene", "outcome"]
    more = read_episodes(f"note,run_id,own,{HEADER}x,1,0.5,{LINE}".encode())
    assert [*more] == [*HEADER.strip().split(","), "own"]
    assert more.loc[0, ["outcome", "steps", "return", "own"]].tolist() == ["success", 9, -1.5, 0.5]


@pytest.mark.parametrize("content", [b"", b"a: [", b"# " + b"x" * 2**20, b"a: &a 1\nb: *a"])
def test_a_config_that_is_damaged_is_refused(content):
    with pytest.raises(ValueError):
        config_reader()(content)


def test_a_damaged_or_missing_file_is_a_problem_of_its_run_alone(output_dir):
    made = make_store(output_dir, "e", {"": []}, range(5))
    folders = [output_dir / f"mlflow-artifacts/e/{run.run_id}/artifacts" for run in made.values()]
    (folders[0] / "episodes.csv").write_text("")
    (folders[1] / "episodes.csv").unlink()
    (folders[2] / "metrics.jsonl").write_text('{"step": 1}\n')
    (folders[3] / "config.yaml").write_text("total_timesteps: many\nseed: 4")
    (folders[4] / "config.yaml").write_text("a: [")
    results = load("e", output_dir=output_dir)
    problem = r"run \w+ \(.*, seed (\d)\): (\S+ (?:is missing|can't be read)).*"
    assert [re.fullmatch(problem, text).groups() for text in results.problems] == [
        ("4", "config.yaml can't be read"),
        ("2", "metrics.jsonl can't be read"),
        ("0", "episodes.csv can't be read"),
        ("1", "episodes.csv is missing"),
    ]
    run_ids = [run.run_id for run in made.values()]
    assert {*results.episodes["run_id"]} == {*run_ids[2:]}
    assert {*results.curves["run_id"]} == {*run_ids} - {run_ids[2]}
    assert results.runs["config.total_timesteps"].tolist() == [400, 400, 400, "many", None]
    assert results.runs["config.seed"].tolist() == [0, 1, 2, 4, None]


def test_runs_that_are_not_done_have_what_they_came_to_and_no_final_numbers(ablation):
    output_dir, made = ablation
    results = load("her", output_dir=output_dir)
    run_ids = [made[key].run_id for key in (("four", 2), ("none", 1), ("none", 2))]
    failed, running, interrupted = run_ids
    unfinished = results.runs.set_index("run_id").loc[run_ids]
    assert unfinished["status"].tolist() == ["failed", "running", "interrupted"]
    assert unfinished["steps"].tolist() == [200, 200, 0]
    assert unfinished["cpu_s"].tolist()[:2] == [150.0, 150.0]
    assert unfinished[[*frames.FINAL_COLUMNS.values()]].isna().all(axis=None)
    assert unfinished["error"].tolist()[0] == "ValueError: <b> no"
    assert unfinished["error"].isna().tolist() == [False, True, True]
    assert unfinished["ended"].isna().tolist() == [False, True, False]
    steps = results.curves.groupby("run_id")["step"].agg(list)
    assert steps[failed] == steps[running] == [100, 200]
    assert interrupted not in steps
    counts = results.episodes["run_id"].value_counts()
    assert counts[run_ids].tolist() == [2 * 3, 0, 0]
    assert results.problems == ()


def test_runs_of_others_and_deleted_ones_are_left_out(output_dir):
    made = make_store(output_dir, "e", {"": []}, range(2))
    client = store(output_dir)
    experiment_id = client.get_experiment_by_name("e").experiment_id
    client.create_run(experiment_id, run_name="by hand")
    odd = {"cell": "c", "seed": "one", "run_key": "k", "run_dir": "d", "status": "done"}
    client.create_run(experiment_id, tags=odd)
    client.delete_run(made["", 1].run_id)
    results = load("e", output_dir=output_dir)
    assert list(results.runs["run_id"]) == [made["", 0].run_id]
    assert (
        set(results.curves["run_id"])
        == set(results.runs["run_id"])
        == set(results.episodes["run_id"])
    )


def test_a_run_that_was_stored_twice_is_a_problem(output_dir, tmp_path):
    make_store(output_dir, "e", {"": []}, [0])
    (twin,) = make_store(tmp_path, "e", {"": []}, [0], uri=default_uri(output_dir)).values()
    results = load("e", output_dir=output_dir)
    assert len(results.runs) == 2
    assert results.problems == (
        f"e, {twin.read_config().cell_name}, seed 0: several runs have this cell and seed",
    )


def test_a_missing_store_is_not_made(tmp_path):
    with pytest.raises(ResultsError, match="there is no store"):
        load("her", output_dir=tmp_path / "outputs")
    assert list(tmp_path.iterdir()) == []


def test_an_unreadable_store_is_a_sentence(tmp_path):
    (tmp_path / "mlflow.db").write_text(
        text := "this is not a database, and it is long enough to be looked at " * 20
    )
    with pytest.raises(ResultsError, match="can't be read: file is not a database"):
        load("her", output_dir=tmp_path)
    assert (tmp_path / "mlflow.db").read_text() == text
    refused = pytest.raises(
        ResultsError, match=r"http://127\S+ can't be read: .*Connection refused"
    )
    with closed_port() as port, refused:
        load("her", uri=f"http://127.0.0.1:{port}")


def test_an_experiment_that_is_unknown_or_has_no_runs_is_refused(ablation, output_dir):
    uri = default_uri(ablation[0])
    with pytest.raises(ResultsError, match=r"experiment=hers: .*; did you mean 'her'\?$"):
        load("hers", uri=uri)
    with pytest.raises(ResultsError, match=r"experiment=zzz: .*; choose from her$"):
        load(["her", "zzz"], uri=uri)
    client = store(output_dir)
    client.create_run(client.create_experiment("void"))
    with pytest.raises(ResultsError, match=r"^experiment=void: it has no runs"):
        load("void", output_dir=output_dir)


def test_a_real_run_is_loaded_as_it_was_trained(smoke):
    results = load("smoke", output_dir=smoke.output_dir)
    log = MetricsLog(smoke.path / "metrics.jsonl")
    latest = log.latest()
    run = row(results.runs, smoke)
    config = smoke.read_config()
    expected = {
        "experiment": "smoke",
        "cell": config.cell_name,
        "seed": 0,
        "run_key": config.run_key,
        "status": "done",
        "steps": 400,
        "run_dir": str(smoke.path),
        "config.total_timesteps": 400,
    }
    assert {name: run[name] for name in expected} == expected
    assert pd.isna(run["error"])
    assert run["started"] < run["ended"]
    for key, name in {**frames.FINAL_COLUMNS, **frames.COST_COLUMNS}.items():
        assert run[name] == latest[key] if key in latest else np.isnan(run[name])
    evaluations = log.frame().dropna(subset="eval/success_rate")
    assert results.curves["step"].tolist() == evaluations["step"].tolist()
    for key, name in {**CURVE_COLUMNS, "time/cpu_s": "cpu_s"}.items():
        if key in evaluations:
            assert results.curves[name].tolist() == evaluations[key].tolist()
    assert results.curves["failure_rate"].isna().all()  # of other tasks
    stored = results.episodes.drop(columns="run_id")
    pd.testing.assert_frame_equal(
        stored, pd.read_csv(smoke.path / "episodes.csv").astype(EPISODE_TYPES)
    )
    assert results.problems == ()


PATHS = b"scene,step,x_m,y_m,heading_rad\n0,0,0.5,0,3.1\n0,1,1.25,-2,3.2\n"


def test_paths_are_those_of_the_lowest_finished_seed_of_each_cell(output_dir):
    """A cell without any, as earlier versions made them, is no problem."""
    file = {"paths.csv.gz": gzip.compress(PATHS)}
    looks = {
        ("four", 0): Look(status="failed", contents=file),
        ("four", 1): Look(contents=file),
        ("four", 2): Look(contents=file),
        ("none", 0): Look(),
        ("none", 1): Look(contents=file),
        ("none", 2): Look(),
    }
    made = make_store(output_dir, "her", HER, range(3), lambda *key: looks[key])
    results = load("her", output_dir=output_dir)
    expected = pd.read_csv(io.BytesIO(PATHS), dtype={"y_m": float})
    expected.insert(0, "run_id", made["four", 1].run_id)
    pd.testing.assert_frame_equal(results.paths, expected)
    assert results.problems == ()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        PATHS,
        gzip.compress(PATHS)[:-9],
        gzip.compress(PATHS.replace(b"scene", b"start")),
        gzip.compress(PATHS.replace(b"0.5", b"inf")),
        gzip.compress(PATHS.replace(b"0.5", b"left")),
    ],
    ids=["empty", "not compressed", "cut", "no scenes", "not finite", "not a number"],
)
def test_damaged_paths_are_a_problem_and_left_out(output_dir, content):
    look = Look(contents={"paths.csv.gz": content})
    make_store(output_dir, "e", {"": []}, [0], lambda *key: look)
    results = load("e", output_dir=output_dir)
    (problem,) = results.problems
    assert "paths.csv.gz can't be read: " in problem
    assert results.paths.empty
    assert len(results.episodes) > 0


@needs_server
def test_a_server_gives_the_same_frames_as_an_embedded_store(tmp_path, capfd):
    looks = {
        **LOOKS,
        ("four", 1): Look(missing=["episodes.csv"]),
        ("none", 0): Look(nan=["eval/return_mean"]),
    }
    make_store(tmp_path / "local", "her", HER, range(3), lambda *key: looks[key])
    local = load("her", output_dir=tmp_path / "local")
    capfd.readouterr()
    with closed_port() as port:
        pass
    with mlflow_server(port, tmp_path) as uri:
        make_store(tmp_path, "her", HER, range(3), lambda *key: looks[key], uri=uri)
        results = load("her", uri=uri)
        assert capfd.readouterr() == ("", "")  # no progress bars of downloads
        assert results.runs["artifact_uri"].str.startswith("mlflow-artifacts:").all()
        places = [
            "run_id",
            "run_dir",
            "artifact_uri",
            "config.output_dir",
            "config.tracking.uri",
            "ended",
        ]
        pd.testing.assert_frame_equal(
            results.runs.drop(columns=places), local.runs.drop(columns=places)
        )
        for name in ("curves", "episodes"):
            pd.testing.assert_frame_equal(
                by_cell_and_seed(results, name), by_cell_and_seed(local, name)
            )
        assert [problem.partition("episodes.csv ")[2] for problem in results.problems] == [
            "is missing in the store"
        ]


def by_cell_and_seed(results, name):
    """A frame in which cell and seed stand for the run."""
    known = (
        results.runs.set_index("run_id")["cell"]
        + " "
        + results.runs.set_index("run_id")["seed"].astype(str)
    )
    frame = getattr(results, name)
    frame = frame.assign(run_id=frame["run_id"].astype(str).map(known))
    return frame.sort_values(["run_id", "step"], kind="stable", ignore_index=True)

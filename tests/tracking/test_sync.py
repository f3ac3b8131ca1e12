"""The store agrees with the run directories: under load, after kills, and after it was down."""

import importlib
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from functools import cache
from pathlib import Path

import pytest
from support.mlflow_servers import closed_port, mlflow_server, needs_server
from support.runs import (
    ROOT,
    artifacts,
    assert_store_is_whole,
    history,
    in_memory,
    make_config,
    only_run,
    run_script,
    store,
)
from support.sync_processes import KEYS, grow, sync

from parking_exp.config.paths import default_uri
from parking_exp.runs.directory import RunDirectory, RunResult
from parking_exp.runs.files import write_json
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.metric_logs import restore_logs
from parking_exp.runs.provenance import provenance
from parking_exp.tracking import artifacts as sent_files
from parking_exp.tracking import sync as syncing
from parking_exp.tracking.client import connect
from parking_exp.tracking.failures import is_store_failure, reason
from parking_exp.tracking.sync import flatten, try_sync
from parking_exp.tracking.sync_all import in_step as in_step_with
from parking_exp.tracking.sync_all import known_statuses, sync_all
from parking_exp.tracking.tracker import open_tracker
from parking_exp.training import checkpoints
from parking_exp.training.train_run import train


def later(output_dir, uri=""):
    where = f" tracking.uri={uri}" if uri else ""
    return f"`python scripts/status.py sync=true output_dir={output_dir}{where}` sends what is missing"


QUICK = ("experiment=smoke", "evaluation.video_episodes=0", "tracking.tensorboard=false")


@cache
def smoke_config():
    return make_config("experiment=smoke")


def sync_everything(output_dir, *uris):
    """Sync every run of an output directory with its embedded store or others; what was in the way of each."""
    directories = [RunDirectory(path) for path in find_runs(output_dir)]
    return [problem for _, problem in sync_all(directories, [default_uri(output_dir), *uris])]


def in_step(directory):
    return in_step_with(directory, known_statuses(directory.tracking_uri, [directory]))


@pytest.fixture(scope="module")
def empty_store():
    """An initialised database: to make one takes seconds."""
    with in_memory() as folder:
        connect(default_uri(Path(folder)))
        yield Path(folder, "mlflow.db")


@pytest.fixture
def fresh_dir():
    """An output directory without a store."""
    with in_memory() as folder:
        yield Path(folder)


@pytest.fixture
def output_dir(fresh_dir, empty_store):
    """An output directory with an empty store."""
    shutil.copy(empty_store, fresh_dir)
    return fresh_dir


def written_run(output_dir, seed=0, uri=None):
    """A run directory as at the start of a training, without one."""
    smoke = smoke_config()
    tracking = smoke.tracking.model_copy(update={"uri": uri})
    config = smoke.model_copy(update={"output_dir": str(output_dir), "seed": seed, "tracking": tracking})
    directory = RunDirectory(config.run_dir)
    directory.create(config)
    directory.update(status="running", tracking_uri=uri or default_uri(output_dir))
    return directory


def finish(directory):
    (directory.path / "episodes.csv").write_text("phase,step\n")
    directory.finish(RunResult(str(directory.path), directory.run_id, 1, {}))


def local_points(directory, up_to=None):
    """Every (key, step, value, time) of a run directory, up to a step."""
    lines = (directory.path / "metrics.jsonl").read_text().splitlines()
    return sorted(
        (key, record["step"], value, record["time_ms"])
        for record in map(json.loads, lines)
        for key, value in record["metrics"].items()
        if up_to is None or record["step"] <= up_to
    )


def rows(output_dir, query):
    with closing(sqlite3.connect(output_dir / "mlflow.db")) as database:
        return database.execute(query).fetchall()


def stored_points(output_dir, run_id):
    """Every row of the metrics table: a number that was logged twice would be there twice."""
    return sorted(rows(output_dir, f"SELECT key, step, value, timestamp FROM metrics WHERE run_uuid = '{run_id}'"))


def processes(command, paths, **env):
    arguments = [sys.executable, str(ROOT / "tests" / "support" / "sync_processes.py"), command, *map(str, paths)]
    return subprocess.run(
        arguments, check=False, capture_output=True, text=True, timeout=300, env={**os.environ, **env}
    )


def content(output_dir):
    """The whole store: each row of the database, and each artifact with its times."""
    with closing(sqlite3.connect(output_dir / "mlflow.db")) as database:
        dump = list(database.iterdump())
    files = sorted((output_dir / "mlflow-artifacts").rglob("*"))
    return dump, [(path, path.stat().st_mtime_ns, path.stat().st_ino) for path in files]


@pytest.mark.slow
def test_sixteen_processes_write_into_a_fresh_store_at_once_and_each_number_arrives_once(fresh_dir):
    directories = [written_run(fresh_dir, seed) for seed in range(16)]
    done = processes("at-once", [directory.path for directory in directories])
    assert (done.returncode, done.stderr) == (0, "")
    assert rows(fresh_dir, "SELECT count(*) FROM metrics") == [(16 * 2 * 180 * len(KEYS),)]
    assert rows(fresh_dir, "SELECT name FROM experiments ORDER BY name") == [("Default",), ("smoke",)]
    assert rows(fresh_dir, "SELECT status, count(*) FROM runs GROUP BY status") == [("FINISHED", 16)]
    for directory in directories:
        assert stored_points(fresh_dir, directory.run_id) == local_points(directory)
        assert [path.split("/")[1] for path in artifacts(store(fresh_dir), directory.run_id, "checkpoints")] == [
            "step=0000000180", "step=0000000180", "step=0000000360", "step=0000000360"]  # fmt: skip


@pytest.mark.slow
def test_a_sync_that_is_killed_anywhere_is_made_whole_by_the_next_one(output_dir):
    first, *directories = [written_run(output_dir, seed) for seed in range(11)]
    for directory in (first, *directories):
        grow(directory, rows=400)  # more than one batch
        finish(directory)
    calls = processes("count", [first.path]).stdout.strip()
    assert int(calls) > 200
    killed = processes("kill", [directory.path for directory in directories], CALLS=calls)
    assert killed.stdout.strip() == str([-9] * 10)
    assert not any(in_step(directory) for directory in directories)
    assert sync_everything(output_dir) == [None] * 10
    assert sync_everything(output_dir) == []
    client = store(output_dir)
    assert rows(output_dir, "SELECT status, count(*) FROM runs GROUP BY status") == [("FINISHED", 11)]
    for directory in directories:
        run = client.get_run(directory.run_id)
        assert stored_points(output_dir, directory.run_id) == local_points(directory)
        assert run.data.params == flatten(directory.config().plain())
        assert run.data.tags["status"] == "done"
        assert artifacts(client, directory.run_id) == artifacts(client, first.run_id)


def test_syncing_again_changes_nothing(output_dir):
    directory = written_run(output_dir)
    grow(directory, rows=10)
    finish(directory)
    sync(directory)
    before = content(output_dir)
    status = directory.read_status()
    sync(directory)
    (directory.path / "synced.json").unlink()  # as after a kill at the end of the first
    assert not in_step(directory)
    sync(directory)
    assert content(output_dir)[0] == before[0]
    assert directory.read_status() == status
    sync(directory)
    assert in_step(directory)


@pytest.mark.slow
def test_what_is_in_step_is_left_alone_and_a_store_that_was_lost_is_made_again(output_dir):
    directory = written_run(output_dir)
    finish(directory)
    sync(directory)
    before = content(output_dir)
    assert sync_everything(output_dir) == []
    assert content(output_dir) == before
    (output_dir / "mlflow.db").unlink()
    assert processes("scan", [output_dir]).stdout.split() == ["1"]
    assert store(output_dir).get_run(directory.run_id).data.tags["status"] == "done"


def test_a_lost_store_is_made_again_also_where_something_has_written_to_the_new_one(output_dir, empty_store):
    directories = [written_run(output_dir, seed) for seed in range(4)]
    for directory in directories:
        grow(directory, rows=5)
        finish(directory)
        sync(directory)
    shutil.copy(empty_store, output_dir)  # another one in its place
    sync(directories[2])  # as an evaluation does
    assert sync_everything(output_dir) == [None] * 3
    assert sync_everything(output_dir) == []
    assert rows(output_dir, "SELECT status, count(*) FROM runs GROUP BY status") == [("FINISHED", 4)]
    for directory in directories:
        assert stored_points(output_dir, directory.run_id) == local_points(directory)


def test_a_run_that_a_user_has_deleted_in_the_store_stays_deleted(output_dir):
    directory = written_run(output_dir)
    finish(directory)
    sync(directory)
    store(output_dir).delete_run(directory.run_id)
    assert sync_everything(output_dir) == []


def test_a_run_that_was_killed_sends_nothing_above_its_last_checkpoint(output_dir):
    directory = written_run(output_dir)
    grow(directory, rows=20)
    grow(directory, rows=7, checkpoint=False)
    assert sync_everything(output_dir) == [None]
    run_id = directory.run_id
    assert stored_points(output_dir, run_id) == local_points(directory, up_to=20)
    run = store(output_dir).get_run(run_id)
    assert (run.info.status, run.data.tags["status"], directory.status) == ("KILLED", "interrupted", "running")
    assert sync_everything(output_dir) == []

    restore_logs(directory.path, directory.checkpoints / "step=0000000020")
    time.sleep(0.002)  # the same steps come at another time
    with directory.training_lock():  # it goes on
        sync(directory)
        assert store(output_dir).get_run(run_id).info.status == "RUNNING"
        grow(directory, rows=15)
        finish(directory)
        sync(directory)
    assert directory.run_id == run_id
    assert stored_points(output_dir, run_id) == local_points(directory)
    run = store(output_dir).get_run(run_id)
    assert (run.info.status, run.data.tags["status"]) == ("FINISHED", "done")


LOST = {
    "gone": lambda path: path.unlink(),
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-70]),
    "flipped": lambda path: path.write_bytes(b"\x00" + path.read_bytes()[1:]),
}


def ended(output_dir):
    """A run that is done."""
    directory = written_run(output_dir)
    grow(directory, rows=20)
    directory.finish(RunResult(str(directory.path), directory.run_id, 20, {}))
    return directory


def test_a_finished_run_that_has_lost_its_metrics_keeps_those_of_the_store(output_dir):
    directory = ended(output_dir)
    sync(directory)
    before, run_id = stored_points(output_dir, directory.run_id), directory.run_id
    LOST["cut"](directory.path / "metrics.jsonl")
    (directory.path / "synced.json").unlink()
    sync(directory)
    assert directory.run_id == run_id
    assert stored_points(output_dir, run_id) == before


@pytest.mark.parametrize("kind", ["gone", "cut"])
def test_a_run_that_was_cut_off_and_has_lost_its_metrics_has_those_of_its_checkpoint_in_the_store(output_dir, kind):
    directory = written_run(output_dir)
    grow(directory, rows=20)
    points = local_points(directory)
    sync(directory)
    LOST[kind](directory.path / "metrics.jsonl")
    (directory.path / "synced.json").unlink()
    assert sync_everything(output_dir) == [None]
    assert stored_points(output_dir, directory.run_id) == points


def test_a_run_that_has_lost_a_checkpoint_keeps_what_the_store_has(output_dir):
    directory = written_run(output_dir)
    grow(directory, rows=20)
    grow(directory, rows=20)
    points = local_points(directory)
    sync(directory)
    run_id = directory.run_id
    shutil.rmtree(directory.checkpoints / "step=0000000040")
    (directory.path / "synced.json").unlink()
    assert sync_everything(output_dir) == [None]
    assert directory.run_id == run_id
    assert stored_points(output_dir, run_id) == points


def test_a_damaged_copy_in_a_checkpoint_is_not_taken_for_the_log(output_dir):
    directory = written_run(output_dir)
    grow(directory, rows=20)
    grow(directory, rows=20)
    LOST["flipped"](directory.checkpoints / "step=0000000040" / "metrics.jsonl")
    assert sync_everything(output_dir) == [None]
    assert stored_points(output_dir, directory.run_id) == local_points(directory, up_to=20)


def test_an_error_of_ours_is_not_called_the_stores_and_stops_nothing(output_dir, monkeypatch):
    directory, said = written_run(output_dir), []
    monkeypatch.setattr(syncing, "flatten", {}.__getitem__)
    tracker = open_tracker(directory.config(), directory, said.append)
    problem = directory.unsynced
    path = directory.path / "sync_traceback.txt"
    assert problem.startswith("an error of parking_exp: ")
    assert problem.endswith(f"; its traceback is in {path}; please report it")
    assert "tracking/sync.py" in path.read_text()
    assert path.read_text().startswith("Traceback (most recent call last)")
    assert len(said) == 1
    monkeypatch.undo()
    tracker.close()
    assert (directory.unsynced, path.exists()) == (None, False)


def test_a_run_that_waits_to_go_on_is_interrupted_in_the_store(output_dir):
    directory = written_run(output_dir)
    directory.update(status="pending")  # frozen again by a sweep that was killed then
    assert sync_everything(output_dir) == [None]
    assert store(output_dir).get_run(directory.run_id).data.tags["status"] == "interrupted"


def test_mlflows_ui_is_told_what_experiments_and_runs_are(output_dir):
    directory, client = ended(output_dir), store(output_dir)
    directory.update(command="python scripts/train.py experiment=smoke")
    rates = {f"final/{name}_rate": rate for name, rate in {"success": 0.94, "crash": 0.04, "parked": 0.0}.items()}
    write_json(directory.path / "result.json", {"run_dir": "", "run_id": None, "steps": 60000, "metrics": rates})
    sync(directory)
    experiment = client.get_experiment_by_name("smoke")
    assert experiment.tags["mlflow.experimentKind"] == "custom_model_development"
    view = json.loads(experiment.tags["mlflow.sharedViewState.results"])
    assert view["name"] == "results"
    assert json.loads(view["state"])["selectedColumns"][0] == "metrics.`final/success_rate`"
    assert "experiment=smoke" in experiment.tags["mlflow.note.content"]
    assert client.get_run(directory.run_id).data.tags["mlflow.note.content"] == (
        "sac, her_future on parking, seed 0: success 94.0%, crash 4.0%, parked 0.0% on 5 scenes, 5 of them certified on highway-env,"
        " after 60,000 env steps.\n\nTyped: `python scripts/train.py experiment=smoke`"
    )
    client.set_tag(directory.run_id, "mlflow.note.content", "my own words")
    client.set_experiment_tag(experiment.experiment_id, "mlflow.note.content", "mine")
    directory.update(command="python scripts/train.py")
    sync(directory)
    assert client.get_run(directory.run_id).data.tags["mlflow.note.content"] == "my own words"
    assert client.get_experiment_by_name("smoke").tags["mlflow.note.content"] == "mine"


@pytest.mark.parametrize(("status", "theirs"), [("failed", "FAILED"), ("interrupted", "KILLED")])
def test_a_run_that_broke_sends_nothing_above_its_last_checkpoint(output_dir, status, theirs):
    directory = written_run(output_dir)
    grow(directory, rows=20)
    grow(directory, rows=7, checkpoint=False)
    (directory.path / "traceback.txt").write_text("Traceback")
    directory.update(status=status)
    sync(directory)
    assert stored_points(output_dir, directory.run_id) == local_points(directory, up_to=20)
    run, client = store(output_dir).get_run(directory.run_id), store(output_dir)
    assert (run.info.status, run.data.tags["status"]) == (theirs, status)
    assert "traceback.txt" in artifacts(client, directory.run_id)
    (directory.path / "traceback.txt").unlink()  # typed again, it goes on
    directory.update(status="running")
    with directory.training_lock():
        sync(directory)
    assert "traceback.txt" not in artifacts(client, directory.run_id)


def test_the_reason_of_a_failure_is_in_the_store_until_the_run_goes_on(output_dir):
    directory, client = written_run(output_dir), store(output_dir)
    directory.update(status="failed", error="ValueError: a loss\n  of NaN " + 500 * "x")
    sync(directory)
    reason = client.get_run(directory.run_id).data.tags["error"]
    assert reason == "ValueError: a loss of NaN " + 471 * "x" + "..."
    assert len(reason) == 500
    directory.update(status="running", error=None)
    with directory.training_lock():
        sync(directory)
    assert client.get_run(directory.run_id).data.tags["error"] == ""


def test_a_run_that_fails_again_for_another_reason_is_not_in_step(output_dir):
    directory, client = written_run(output_dir), store(output_dir)
    directory.update(status="failed", error="ValueError: the first")
    sync(directory)
    assert in_step(directory)
    # As its supervisor does for a process that was killed before it could open its store.
    directory.update(status="failed", error="killed by SIGKILL (out of memory?)", killed=True)
    assert sync_everything(output_dir) == [None]
    assert client.get_run(directory.run_id).data.tags["error"] == "killed by SIGKILL (out of memory?)"
    assert sync_everything(output_dir) == []


def test_a_run_that_is_trained_afresh_in_the_same_place_takes_the_place_of_the_old_one(output_dir):
    directory = written_run(output_dir)
    grow(directory, rows=30)
    finish(directory)
    sync(directory)
    old = directory.run_id
    shutil.rmtree(directory.path)
    time.sleep(0.002)
    directory = written_run(output_dir)
    grow(directory, rows=20)
    sync(directory)
    assert directory.run_id != old
    assert stored_points(output_dir, directory.run_id) == local_points(directory)
    client = store(output_dir)
    (found,) = client.search_runs([client.get_experiment_by_name("smoke").experiment_id])
    assert found.info.run_id == directory.run_id
    assert client.get_run(old).info.lifecycle_stage == "deleted"


def test_what_others_log_to_a_run_is_left_alone(output_dir):
    directory, client = written_run(output_dir), store(output_dir)
    grow(directory, rows=5)
    sync(directory)
    run_id = directory.run_id
    client.log_metric(run_id, "my/note", 1.0, step=99)
    client.set_tag(run_id, "starred", "yes")
    grow(directory, rows=5)
    sync(directory)
    assert directory.run_id == run_id
    assert history(client, run_id, "my/note") == [(99, 1.0)]
    assert client.get_run(run_id).data.tags["starred"] == "yes"


def test_a_run_that_another_process_works_on_is_left_to_it(output_dir):
    directory = written_run(output_dir)
    with directory.training_lock():
        assert sync_everything(output_dir) == []
    assert sync_everything(output_dir) == [None]


def test_provenance_is_that_of_the_process_that_trained(output_dir):
    directory = written_run(output_dir)
    trained = {**provenance(), "version.torch": "1.2.3", "cpu": "another machine's"}
    (directory.path / "provenance.json").write_text(json.dumps({"started_ms": 1234567, "tags": trained}))
    sync(directory)
    run = store(output_dir).get_run(directory.run_id)
    assert trained.items() <= run.data.tags.items()
    assert run.info.start_time == 1234567


def test_a_store_that_has_just_failed_is_left_alone_until_the_end(fresh_dir):
    blocked = fresh_dir / "blocked"
    blocked.touch()  # a file where the database's folder is to be
    uri = f"sqlite:///{blocked / 'mlflow.db'}"
    directory, said = written_run(fresh_dir, uri=uri), []
    tracker = open_tracker(directory.config(), directory, said.append)
    problem = f"File exists: {blocked}"
    assert said == [f"the store {uri} has not got everything ({problem}); the run goes on, and {later(fresh_dir, uri)}"]
    assert directory.unsynced == problem
    blocked.unlink()
    tracker.sync()
    assert directory.unsynced == problem
    tracker.close()
    assert directory.unsynced is None
    assert "unsynced" not in directory.read_status()
    assert said[1:] == ["the store has everything now"]


def test_a_thousand_runs_do_not_each_wait_for_a_server_that_is_down(fresh_dir):
    with closed_port() as port:
        directories = [written_run(fresh_dir, seed, f"http://127.0.0.1:{port}") for seed in range(3)]
        for directory in directories:
            directory.update(status="done")
        uri = f"http://127.0.0.1:{port}"
        assert sync_everything(fresh_dir, uri) == ["Connection refused"] * 3
        # The store was asked once, for all of them.
        assert [directory.unsynced for directory in directories] == [None] * 3


def test_a_store_that_is_no_database_is_told_at_once(fresh_dir):
    (fresh_dir / "mlflow.db").write_text("this is not a database, and it is long enough to be looked at " * 20)
    assert try_sync(written_run(fresh_dir), default_uri(fresh_dir)) == "file is not a database"


def test_reasons_have_no_password():
    error = ValueError("no server at postgresql://me:secret@db.example:5432/mlflow")
    assert reason(error) == "no server at postgresql://me@db.example:5432/mlflow"


DRIVERS = {
    "postgresql://me@host/db": ("psycopg2", "psycopg2-binary"),
    "mysql://me@host/db": ("MySQLdb", "mysqlclient"),
    "mysql+pymysql://me@host/db": ("pymysql", "pymysql"),
}


@pytest.mark.parametrize("uri", DRIVERS)
def test_a_driver_that_is_not_installed_is_named_with_what_to_install(monkeypatch, uri):
    module, package = DRIVERS[uri]
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError) as failure:
        connect(uri)
    assert is_store_failure(failure.value)
    assert reason(failure.value) == f"the package {module!r} is not installed: pip install {package}"


def test_an_import_of_ours_that_fails_is_no_failure_of_the_store():
    with pytest.raises(ImportError) as failure:
        importlib.import_module("parking_exp.nowhere")
    assert not is_store_failure(failure.value)


def test_names_in_a_checkpoint_are_those_that_training_writes():
    for name in ("MODEL", "BUFFER", "STATE", "MANIFEST"):
        assert getattr(sent_files, name) == getattr(checkpoints, name)


@pytest.mark.slow
def test_a_store_that_fails_in_the_middle_gets_the_rest_later(output_dir, capsys):
    connect(default_uri(output_dir))
    with closing(sqlite3.connect(output_dir / "mlflow.db")) as database:
        database.execute(
            "CREATE TRIGGER full BEFORE INSERT ON metrics WHEN NEW.step > 200 "
            "BEGIN SELECT RAISE(ABORT, 'database or disk is full'); END"
        )
    result = train(make_config(*QUICK, f"output_dir={output_dir}"))
    directory, (out, err) = only_run(output_dir), capsys.readouterr()
    assert (directory.status, directory.unsynced) == ("done", "database or disk is full")
    assert out.endswith(f"not all of it is in the store (database or disk is full); {later(output_dir)}\n")
    assert err.count("database or disk is full") == 1
    assert max(step for _, step, _, _ in stored_points(output_dir, result.run_id)) == 200
    with closing(sqlite3.connect(output_dir / "mlflow.db")) as database:
        database.execute("DROP TRIGGER full")
    assert sync_everything(output_dir) == [None]
    assert directory.unsynced is None
    assert directory.run_id == result.run_id
    assert_store_is_whole(output_dir, 400)


@pytest.mark.slow
def test_a_run_whose_store_is_down_is_done_and_the_store_gets_all_of_it_later(smoke, tmp_path):
    """The same run as `smoke`, whose store was healthy."""
    healthy, _, healthy_dir = smoke
    blocked = tmp_path / "mlflow.db"
    blocked.mkdir()  # a folder where the database is to be
    done = run_script("train", "experiment=smoke", f"output_dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    directory, problem = only_run(tmp_path), "unable to open database file"
    assert (directory.status, directory.unsynced, directory.run_id) == ("done", problem, None)
    assert f"not all of it is in the store ({problem}); {later(tmp_path)}" in done.stdout
    assert done.stderr.count(problem) == 1
    assert "Traceback" not in done.stderr
    evaluated = run_script(
        "evaluate", f"run={directory.path}", f"output_dir={tmp_path}", "episodes=2", "simulator=vectorized", "name=two"
    )
    assert evaluated.returncode == 0, evaluated.stderr
    assert f"not stored     {problem}; {later(tmp_path)}" in evaluated.stdout
    assert (directory.path / "evaluations" / "two" / "summary.json").exists()

    blocked.rmdir()
    assert sync_everything(tmp_path) == [None]
    assert directory.result().run_id == directory.run_id is not None
    assert_store_is_whole(tmp_path, 400)
    ours, theirs = store(tmp_path).get_run(directory.run_id), store(healthy_dir).get_run(healthy.run_id)
    assert {**ours.data.params, "output_dir": ""} == {**theirs.data.params, "output_dir": ""}
    own = dict.fromkeys(("run_dir", "mlflow.runName", "mlflow.note.content"), "")
    assert {**ours.data.tags, **own} == {**theirs.data.tags, **own}
    ours_metrics, theirs_metrics = (
        {key: value for key, value in run.data.metrics.items() if not key.startswith("time/")} for run in (ours, theirs)
    )
    assert ours_metrics == theirs_metrics
    assert set(ours.data.metrics) == set(theirs.data.metrics)
    stored = set(artifacts(store(tmp_path), directory.run_id))
    assert stored - {"evaluations/two/episodes.csv", "evaluations/two/summary.json"} == {
        path for path in artifacts(store(healthy_dir), healthy.run_id) if not path.startswith("evaluations/")
    }


@pytest.mark.slow
def test_a_run_goes_on_without_its_server(tmp_path):
    with closed_port() as port:
        uri = f"http://127.0.0.1:{port}"
        train(make_config(*QUICK, f"output_dir={tmp_path}", "total_timesteps=60", f"tracking.uri={uri}"))
        directory = only_run(tmp_path)
        assert (directory.status, directory.unsynced) == ("done", "Connection refused")
        assert not (tmp_path / "mlflow.db").exists()


@needs_server
def test_a_server_that_comes_up_later_gets_everything_artifacts_too(tmp_path):
    with closed_port() as port:
        uri = f"http://127.0.0.1:{port}"
        directory = written_run(tmp_path, uri=uri)
        grow(directory, rows=400)
        finish(directory)
        assert try_sync(directory, directory.tracking_uri) == "Connection refused"
    with mlflow_server(port, tmp_path):
        assert sync_everything(tmp_path, uri) == [None]
        grow(directory, rows=5)
        grow(directory, rows=5)
        sync(directory)
        client = connect(uri)
        stored = [(key, step, value) for key in KEYS for step, value in history(client, directory.run_id, key)]
        assert sorted(stored) == [point[:3] for point in local_points(directory)]
        assert artifacts(client, directory.run_id) == [
            "checkpoints/step=0000000405/model.zip",
            "checkpoints/step=0000000405/replay_buffer.json",
            "checkpoints/step=0000000410/model.zip",
            "checkpoints/step=0000000410/replay_buffer.json",
            "config.yaml",
            "episodes.csv",
            "metrics.jsonl",
        ]

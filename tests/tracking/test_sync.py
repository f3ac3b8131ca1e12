"""The store agrees with the run directories: under load, after kills, and after it was down, lost
or behind.
"""

import errno
import json
import re
import shutil
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import pytest
from support.mlflow_servers import closed_port, mlflow_server, needs_server
from support.runs import (
    ROOT,
    artifacts,
    assert_store_is_whole,
    history,
    only_run,
    run_script,
    store,
    stored_params,
)
from support.sync_processes import KEYS, grow, sync
from support.tracked_runs import finish, finished_run, rows, written_run

from parking_exp.config.paths import default_uri
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.metric_logs import restore_logs
from parking_exp.runs.run_provenance import provenance_tags
from parking_exp.tracking.client import connect
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import sync_missing, try_sync


def sync_all(output_dir, uri=None):
    """Sync what a store lacks of an output directory; what was in the way of each run."""
    directories = map(RunDirectory, find_runs(output_dir))
    store = Store(uri or default_uri(output_dir), output_dir)
    return [problem for _, problem in sync_missing(directories, store)]


@pytest.fixture
def fresh_dir(output_dir):
    """An output directory without a store."""
    (output_dir / "mlflow.db").unlink()
    return output_dir


def local_points(directory, up_to=None):
    """Every (key, step, value, time) of a run directory, up to a step."""
    lines = (directory.path / "metrics.jsonl").read_text().splitlines()
    return sorted(
        (key, record["step"], value, record["time_ms"])
        for record in map(json.loads, lines)
        for key, value in record["metrics"].items()
        if up_to is None or record["step"] <= up_to
    )


def stored_points(output_dir, run_id):
    """Every row of the metrics table: a number that was logged twice would be there twice."""
    return sorted(
        rows(
            output_dir,
            f"SELECT key, step, value, timestamp FROM metrics WHERE run_uuid = '{run_id}'",
        )
    )


def stored_run(directory):
    return store(directory.output_dir).get_run(directory.run_id)


def stored_status(directory):
    """MLflow's own status of a run, and that of its tag."""
    run = stored_run(directory)
    return run.info.status, run.data.tags["status"]


def assert_synced(*directories):
    """The store has these finished runs, each number once, and no other run."""
    output_dir = directories[0].output_dir
    assert rows(output_dir, "SELECT status, count(*) FROM runs GROUP BY status") == [
        ("FINISHED", len(directories))
    ]
    for directory in directories:
        assert stored_points(output_dir, directory.run_id) == local_points(directory)


def processes(command, directories):
    script = ROOT / "tests" / "support" / "sync_processes.py"
    paths = [directory.path for directory in directories]
    arguments = [sys.executable, script, command, *paths]
    return subprocess.run(arguments, check=False, capture_output=True, text=True, timeout=300)


def content(output_dir):
    """The whole store: each row of the database, and each artifact with its times."""
    with closing(sqlite3.connect(output_dir / "mlflow.db")) as database:
        dump = list(database.iterdump())
    files = sorted((output_dir / "mlflow-artifacts").rglob("*"))
    return dump, [(path, path.stat().st_mtime_ns, path.stat().st_ino) for path in files]


@pytest.mark.slow
def test_sixteen_processes_write_into_a_fresh_store_at_once_and_each_number_arrives_once(fresh_dir):
    directories = [written_run(fresh_dir, seed) for seed in range(16)]
    done = processes("at-once", directories)
    assert (done.returncode, done.stderr) == (0, "")
    assert rows(fresh_dir, "SELECT count(*) FROM metrics") == [(16 * 2 * 180 * len(KEYS),)]
    assert rows(fresh_dir, "SELECT name FROM experiments ORDER BY name") == [
        ("Default",),
        ("smoke",),
    ]
    assert_synced(*directories)
    for directory in directories:
        stored = artifacts(store(fresh_dir), directory.run_id, "checkpoint")
        assert stored == ["checkpoint/model.zip"]


@pytest.mark.slow
def test_a_sync_that_is_killed_anywhere_is_completed_by_the_next_one(output_dir):
    first, *directories = [written_run(output_dir, seed) for seed in range(11)]
    for directory in (first, *directories):
        grow(directory, rows=400)  # more than one batch
        finish(directory)
    calls, *endings = map(int, processes("kill", [first, *directories]).stdout.split())
    assert calls > 200
    assert endings == [-9] * 10
    assert sync_all(output_dir) == [None] * 10
    assert sync_all(output_dir) == []
    client = store(output_dir)
    assert_synced(first, *directories)
    for directory in directories:
        run = client.get_run(directory.run_id)
        assert run.data.params == stored_params(directory.read_config())
        assert run.data.tags["status"] == "done"
        assert artifacts(client, directory.run_id) == artifacts(client, first.run_id)


def test_a_second_sync_changes_nothing_even_if_files_were_deleted_from_the_run_directory(
    output_dir,
):
    directory = finished_run(output_dir)
    sync(directory)
    before, status = content(output_dir), directory.read_status()
    sync(directory)
    assert sync_all(output_dir) == []
    assert content(output_dir) == before
    assert directory.read_status() == status
    points, names = (
        stored_points(output_dir, directory.run_id),
        artifacts(store(output_dir), directory.run_id),
    )
    shutil.rmtree(directory.checkpoints)
    (directory.path / "metrics.jsonl").unlink()
    assert sync_all(output_dir) == [None]
    assert directory.run_id == status.run_id
    assert stored_points(output_dir, directory.run_id) == points
    assert artifacts(store(output_dir), directory.run_id) == names


def test_a_lost_or_older_store_is_filled_again_even_after_another_run_was_sent_to_it(
    output_dir, empty, tmp_path
):
    first = written_run(output_dir)
    grow(first, rows=5)
    sync(first)
    shutil.copy(output_dir / "mlflow.db", tmp_path)
    grow(first, rows=5)
    finish(first)
    directories = [first, finished_run(output_dir, seed=1), finished_run(output_dir, seed=2)]
    assert sync_all(output_dir) == [None] * 3
    for database in (empty / "mlflow.db", tmp_path / "mlflow.db"):
        shutil.copy(database, output_dir)
        sync(directories[2])
        assert sync_all(output_dir) == [None] * 2
        assert sync_all(output_dir) == []
        assert_synced(*directories)


def test_a_killed_run_is_synced_up_to_its_last_checkpoint_and_whole_once_resumed(output_dir):
    directory = written_run(output_dir)
    grow(directory, rows=20)
    grow(directory, rows=7, checkpoint=False)
    with directory.training_lock():
        assert sync_all(output_dir) == []  # it is synced while it trains
    assert sync_all(output_dir) == [None]
    run_id = directory.run_id
    assert stored_points(output_dir, run_id) == local_points(directory, up_to=20)
    assert stored_status(directory) == ("KILLED", "interrupted")
    assert directory.status == "running"
    assert sync_all(output_dir) == []

    restore_logs(directory.path, directory.checkpoints / "step=0000000020")
    time.sleep(0.002)  # the same steps come at another time
    with directory.training_lock():
        sync(directory)
        assert stored_status(directory) == ("RUNNING", "running")
        grow(directory, rows=15)
        finish(directory)
        sync(directory)
    assert directory.run_id == run_id
    assert stored_points(output_dir, run_id) == local_points(directory)
    assert stored_status(directory) == ("FINISHED", "done")


def test_a_failed_run_has_its_error_in_the_store_until_it_is_resumed(output_dir):
    directory, client = written_run(output_dir), store(output_dir)
    grow(directory, rows=20)
    grow(directory, rows=7, checkpoint=False)
    (directory.path / "traceback.txt").write_text("Traceback")
    directory.update_status(status="failed", error="ValueError: a loss\n  of NaN " + 500 * "x")
    sync(directory)
    assert stored_points(output_dir, directory.run_id) == local_points(directory, up_to=20)
    assert stored_status(directory) == ("FAILED", "failed")
    error = stored_run(directory).data.tags["error"]
    assert error == "ValueError: a loss of NaN " + 474 * "x"
    assert "traceback.txt" in artifacts(client, directory.run_id)
    directory.update_status(status="running", error=None)
    with directory.training_lock():
        sync(directory)
    assert stored_run(directory).data.tags["error"] == ""


def test_what_a_user_logs_tags_or_deletes_in_the_store_stays(output_dir):
    directory, client = written_run(output_dir), store(output_dir)
    grow(directory, rows=5)
    sync(directory)
    run_id = directory.run_id
    client.log_metric(run_id, "my/note", 1.0, step=99)
    client.set_tag(run_id, "starred", "yes")
    grow(directory, rows=5)
    sync(directory)
    assert history(client, run_id, "my/note") == [(99, 1.0)]
    assert client.get_run(run_id).data.tags["starred"] == "yes"
    client.delete_run(run_id)
    assert sync_all(output_dir) == []
    assert directory.run_id == run_id


def test_a_run_has_its_provenance_and_its_command_as_tags(output_dir):
    directory = finished_run(output_dir, started_ms=1234567)
    directory.update_status(command="python scripts/train.py experiment=smoke")
    tags = {**provenance_tags(), "version.torch": "1.2.3", "cpu": "another machine's"}
    write_json(directory.path / "provenance.json", {"started_ms": 1234567, "tags": tags})
    sync(directory)
    run = stored_run(directory)
    assert (
        tags | {"command": "python scripts/train.py experiment=smoke"}
    ).items() <= run.data.tags.items()
    assert run.info.start_time == 1234567


def test_a_store_that_fails_in_the_middle_is_completed(output_dir):
    directory = finished_run(output_dir)
    change_store = (
        "CREATE TRIGGER full BEFORE INSERT ON metrics "
        "BEGIN SELECT RAISE(ABORT, 'disk is full'); END"
    )
    for statement, problem in ((change_store, "disk is full"), ("DROP TRIGGER full", None)):
        rows(output_dir, statement)
        assert sync_all(output_dir) == [problem]
    assert_synced(directory)


@pytest.mark.slow
def test_a_run_whose_store_is_down_finishes_and_is_sent_later(tmp_path):
    blocked = tmp_path / "mlflow.db"
    blocked.mkdir()  # a folder in place of the database
    done = run_script("train", "experiment=smoke", f"output_dir={tmp_path}", code=0)
    directory = only_run(tmp_path)
    assert (directory.status, directory.run_id) == ("done", None)
    first, last = re.findall(".*unable to open database file.*", done.stderr)
    assert first.startswith(f"the store {directory.tracking_uri} is incomplete (")
    assert last.startswith(f"files and store differ for 1 run, e.g. {directory.path}: ")
    assert "Traceback" not in done.stderr
    blocked.rmdir()
    assert sync_all(tmp_path) == []  # a new store has all runs
    assert directory.read_result().run_id == directory.run_id is not None
    assert_store_is_whole(tmp_path, 400)
    assert_synced(directory)


@needs_server
def test_a_server_that_comes_up_later_gets_everything_artifacts_too(tmp_path):
    with closed_port() as port:
        uri = f"http://127.0.0.1:{port}"
        directory = written_run(tmp_path, uri=uri)
        grow(directory, rows=400)
        finish(directory)
        assert try_sync(directory, Store(uri, tmp_path)) == "[Errno 111] Connection refused"
    with mlflow_server(port, tmp_path):
        assert sync_all(tmp_path, uri) == [None]
        grow(directory, rows=5)
        finish(directory)
        sync(directory)
        client = connect(uri)
        stored = [
            (key, step, value)
            for key in KEYS
            for step, value in history(client, directory.run_id, key)
        ]
        assert sorted(stored) == [point[:3] for point in local_points(directory)]
        assert artifacts(client, directory.run_id) == [
            "checkpoint/model.zip", "config.yaml", "episodes.csv", "metrics.jsonl"
        ]  # fmt: skip


def test_a_directory_that_can_not_be_read_keeps_no_other_run_from_the_store(output_dir):
    unreadable, whole = [finished_run(output_dir, seed) for seed in range(2)]
    (unreadable.path / "curves.png").symlink_to("x" * 300)
    name_too_long, none = sync_all(output_dir)
    assert name_too_long.startswith(f"[Errno {errno.ENAMETOOLONG}]")
    assert none is None
    assert stored_status(whole) == ("FINISHED", "done")

"""A store that is interrupted while it is made is made anew, and nobody's data is touched for it."""

import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import pytest

from parking_exp.config.paths import default_uri
from parking_exp.tracking.client import connect


def execute(database, *statements):
    with closing(sqlite3.connect(database)) as connection, connection:
        return [connection.execute(statement).fetchall() for statement in statements][-1]


def test_a_store_that_a_kill_has_left_half_made_is_set_aside_and_made_anew(tmp_path):
    uri, store, new = default_uri(tmp_path), tmp_path / "mlflow.db", tmp_path / ".mlflow.db.new"
    code = f"from parking_exp.tracking.client import connect; connect({uri!r})"
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    tables = "SELECT name FROM sqlite_master"
    while process.poll() is None and not (new.exists() and ("alembic_version",) in execute(new, tables)):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert not store.exists()
    for file in tmp_path.glob(f"{new.name}*"):  # and its journal, as MLflow itself would have left them
        shutil.copy(file, tmp_path / file.name.replace(new.name, store.name))
    execute(store, "CREATE TABLE IF NOT EXISTS _alembic_tmp_jobs (id TEXT)")  # by which some never work again
    client = connect(uri)
    run = client.create_run(client.create_experiment("after"))
    assert connect(uri).get_run(run.info.run_id).info.status == "RUNNING"
    assert not list(tmp_path.glob(".mlflow.db.new*"))
    assert ("_alembic_tmp_jobs",) in execute(tmp_path / "mlflow.db.unusable", tables)


def test_a_disk_that_is_full_while_a_store_is_made_leaves_no_store_under_its_name(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, limits[1]))
    try:
        with pytest.raises(Exception, match="disk"):
            connect(default_uri(tmp_path))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.name for path in tmp_path.iterdir()] == [".mlflow.db.lock"]


def test_a_store_of_another_mlflow_that_has_runs_is_left_as_it_is(output_dir):
    database = output_dir / "mlflow.db"
    execute(
        database,
        "UPDATE alembic_version SET version_num = '728d730b5ebd'",
        "INSERT INTO runs (run_uuid, experiment_id, lifecycle_stage) VALUES ('a', 0, 'active')",
    )
    before = database.read_bytes()
    with pytest.raises(Exception, match="out-of-date database schema"):
        connect(default_uri(output_dir))
    assert database.read_bytes() == before


def test_a_database_of_another_program_stays_where_it_is(tmp_path):
    database = tmp_path / "other.db"
    execute(database, "CREATE TABLE alembic_version (version_num TEXT)", "INSERT INTO alembic_version VALUES ('1')")
    execute(database, "CREATE TABLE studies (id INTEGER)", "INSERT INTO studies VALUES (1)")
    with pytest.raises(Exception, match="1"):
        connect(f"sqlite:///{database}")
    assert execute(database, "SELECT id FROM studies") == [(1,)]
    assert [path.name for path in tmp_path.glob("other*")] == ["other.db"]


def test_a_store_where_no_file_can_be_made_fails_at_once():
    with pytest.raises(FileNotFoundError, match=r"/proc/\.x\.lock"):
        connect("sqlite:////proc/x")


def test_mlflow_is_imported_for_a_user_without_a_home():
    code = """
import os, pwd
def unknown(uid): raise KeyError(uid)
pwd.getpwuid = unknown
os.environ.pop("HOME", None)
from parking_exp.tracking.client import import_mlflow
import_mlflow()
"""
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stderr) == (0, "")

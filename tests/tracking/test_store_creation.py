"""A store that is interrupted while it is made is made anew, and nobody's data is touched for it."""

import resource
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import pytest

from parking_exp.config.paths import default_uri
from parking_exp.tracking.client import connect

OURS = "from parking_exp.tracking.client import connect; connect({uri!r})"
MLFLOW = (
    "from parking_exp.tracking.client import import_mlflow; import_mlflow();"
    "from mlflow import MlflowClient; MlflowClient({uri!r}).search_experiments()"
)


def kill_while_migrating(code, database, uri):
    """Start a process that makes a store, and kill it in the middle of MLflow's migrations."""
    process = subprocess.Popen([sys.executable, "-c", code.format(uri=uri)], stderr=subprocess.DEVNULL)
    while process.poll() is None and not tables(database) & {"alembic_version"}:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL


def tables(database):
    if not database.exists():
        return set()
    with closing(sqlite3.connect(database)) as connection:
        return {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}


def assert_usable(uri):
    client = connect(uri)
    run = client.create_run(client.create_experiment("after"))
    assert connect(uri).get_run(run.info.run_id).info.status == "RUNNING"


def test_a_store_that_mlflow_has_half_made_is_made_anew(tmp_path):
    uri = default_uri(tmp_path)
    kill_while_migrating(MLFLOW, tmp_path / "mlflow.db", uri)
    with closing(sqlite3.connect(tmp_path / "mlflow.db")) as connection, connection:  # what some kills leave
        connection.execute("CREATE TABLE IF NOT EXISTS _alembic_tmp_jobs (id TEXT)")
    again = subprocess.run([sys.executable, "-c", MLFLOW.format(uri=uri)], check=False, capture_output=True, text=True)
    assert "already exists" in again.stderr  # MLflow can't complete it
    assert_usable(uri)


def test_a_kill_while_a_store_is_made_leaves_no_store_under_its_name(tmp_path):
    uri = default_uri(tmp_path)
    kill_while_migrating(OURS, tmp_path / ".mlflow.db.new", uri)
    assert not (tmp_path / "mlflow.db").exists()
    assert_usable(uri)
    assert not list(tmp_path.glob(".mlflow.db.new*"))


def test_a_disk_that_is_full_while_a_store_is_made_leaves_no_store_under_its_name(tmp_path):
    code = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, {resource.RLIM_INFINITY}));"
    done = subprocess.run([sys.executable, "-c", code + OURS.format(uri=default_uri(tmp_path))], check=False)
    assert done.returncode == 1
    assert [path.name for path in tmp_path.iterdir()] == [".mlflow.db.lock"]
    assert_usable(default_uri(tmp_path))


@pytest.mark.parametrize("change", [
    "INSERT INTO experiments (experiment_id, name, artifact_location, lifecycle_stage) VALUES (7, 'theirs', '/', 'active')",
    "INSERT INTO registered_models (name) VALUES ('theirs')",
    "CREATE TABLE theirs AS SELECT 1",
    "INSERT INTO runs (run_uuid, experiment_id, lifecycle_stage) VALUES ('a', 0, 'active')",
])  # fmt: skip
def test_a_store_of_another_mlflow_that_has_something_is_left_as_it_is(output_dir, change):
    database = output_dir / "mlflow.db"
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '728d730b5ebd'")
        connection.execute(change)
    before = database.read_bytes()
    with pytest.raises(Exception, match=r"out-of-date database schema|already exists"):
        connect(default_uri(output_dir))
    assert database.read_bytes() == before


def test_the_database_of_another_program_is_not_replaced(tmp_path):
    database = tmp_path / "other.db"
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute("CREATE TABLE alembic_version (version_num TEXT)")
        connection.execute("CREATE TABLE studies (name TEXT)")
        connection.execute("INSERT INTO studies VALUES ('theirs')")
    connect(f"sqlite:///{database}")
    with closing(sqlite3.connect(database)) as connection:
        assert connection.execute("SELECT name FROM studies").fetchall() == [("theirs",)]

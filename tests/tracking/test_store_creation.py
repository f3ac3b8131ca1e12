"""A store that can't be used is made anew from the run directories, and nobody's data is touched
for it.
"""

import resource
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import pytest
from support.runs import ROOT, names_in, run_code, store, sync_stored
from support.sync_processes import sync
from support.tracked_runs import finished_run

from parking_exp.config.paths import default_uri
from parking_exp.errors import StoreError
from parking_exp.results.frames import load
from parking_exp.tracking.client import connect, import_mlflow
from parking_exp.tracking.embedded_store import rebuild_if_unusable
from parking_exp.tracking.store import Store


def execute(database, *statements):
    with closing(sqlite3.connect(database)) as connection, connection:
        return [connection.execute(statement).fetchall() for statement in statements][-1]


def store_with_runs(output_dir, seeds=3):
    """Run directories of an output directory without a store; the first three of its seeds."""
    (output_dir / "mlflow.db").unlink()
    return [finished_run(output_dir, seed) for seed in range(seeds)]


def stored(output_dir):
    """Return the seeds of the runs that the store has."""
    runs = load("smoke", output_dir=output_dir).runs
    return runs["seed"].tolist()


def test_a_missing_store_is_made_from_all_run_directories(output_dir):
    first, *_ = store_with_runs(output_dir)
    sync(first)
    assert stored(output_dir) == [0, 1, 2]
    assert not list(output_dir.glob("*replaced*"))
    first_id = first.run_id
    (output_dir / "mlflow.db").unlink()
    sync(first)
    assert stored(output_dir) == [0, 1, 2]
    assert first.run_id != first_id
    kept = output_dir / "mlflow-artifacts.replaced-1" / "smoke" / first_id / "artifacts"
    assert (kept / "metrics.jsonl").read_bytes() == (first.path / "metrics.jsonl").read_bytes()


def test_a_store_that_is_made_looks_up_an_experiment_once(output_dir, monkeypatch):
    first, *_ = store_with_runs(output_dir)
    looked_up = []
    find_or_make_experiment = Store.find_or_make_experiment

    def count(self, config):
        looked_up.append(config.experiment_name)
        return find_or_make_experiment(self, config)

    monkeypatch.setattr(Store, "find_or_make_experiment", count)
    rebuild_if_unusable(Store(first.tracking_uri, output_dir))
    assert looked_up == ["smoke"]
    assert stored(output_dir) == [0, 1, 2]


def test_a_run_that_a_new_store_lacks_is_named(output_dir, capsys):
    damaged, whole, _ = store_with_runs(output_dir)
    (damaged.path / "episodes.csv").write_text("")
    sync(whole)
    assert stored(output_dir) == [1, 2]
    problem = (
        f"the new store lacks 1 run, e.g. {damaged.path}: "
        "episodes.csv changed after the run was finished"
    )
    assert problem in capsys.readouterr().err


def test_a_store_that_a_kill_has_left_half_made_is_set_aside_and_made_anew(output_dir):
    directories, database, new = (
        store_with_runs(output_dir),
        output_dir / "mlflow.db",
        output_dir / "new.db",
    )
    code = f"import mlflow; mlflow.MlflowClient('sqlite:///{new}').search_experiments()"
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    tables = "SELECT name FROM sqlite_master"
    while process.poll() is None and not (
        new.exists() and ("alembic_version",) in execute(new, tables)
    ):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    for file in output_dir.glob(f"{new.name}*"):  # and its journal
        file.rename(output_dir / file.name.replace(new.name, database.name))
    execute(
        database, "CREATE TABLE IF NOT EXISTS _alembic_tmp_jobs (id TEXT)"
    )  # by which some never work again
    sync(directories[0])
    assert stored(output_dir) == [0, 1, 2]
    assert ("_alembic_tmp_jobs",) in execute(output_dir / "mlflow.db.replaced-1", tables)
    assert not list(output_dir.glob(".mlflow.db.*new*"))


def test_what_a_killed_build_has_left_is_removed(output_dir):
    first, *_ = store_with_runs(output_dir)
    (output_dir / "mlflow.db.build-0a1b2c3d").write_bytes(b"half")
    leftover = output_dir / "mlflow-artifacts" / "smoke" / "0" / "artifacts"
    leftover.mkdir(parents=True)
    sync(first)
    assert stored(output_dir) == [0, 1, 2]
    assert not leftover.exists()
    assert sorted(path.name for path in output_dir.glob("*mlflow*")) == [
        ".mlflow.db.lock",
        "mlflow-artifacts",
        "mlflow.db",
    ]


@pytest.mark.slow
def test_a_build_that_is_killed_at_any_time_is_completed_by_the_next_command(output_dir):
    store_with_runs(output_dir, seeds=40)
    for delay in (2.0, 2.5, 3.0, 3.5, 4.0, 5.0):
        (output_dir / "mlflow.db").unlink(missing_ok=True)
        process = subprocess.Popen(
            [sys.executable, "scripts/status.py", "sync=true", f"output_dir={output_dir}"],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        time.sleep(delay)
        process.kill()
        process.wait()
        sync_stored(output_dir)
        assert stored(output_dir) == [*range(40)]
        assert not list(output_dir.glob("*.build-*"))


def older_store(path):
    """A store as the MLflow before the last change of its tables made it."""
    import_mlflow()
    from alembic import command
    from alembic.script import ScriptDirectory
    from mlflow.store.db.utils import _get_alembic_config
    from mlflow.store.tracking.dbmodels.initial_models import Base
    from sqlalchemy import create_engine

    uri = f"sqlite:///{path}"
    Base.metadata.create_all(create_engine(uri))
    config = _get_alembic_config(uri)
    scripts = ScriptDirectory.from_config(config)
    command.upgrade(config, scripts.get_revision("head").down_revision)


FOREIGN_RUN = (
    "INSERT INTO runs (run_uuid, experiment_id, lifecycle_stage, status, user_id, start_time) "
    "VALUES ('a', 0, 'active', 'RUNNING', 'x', 0)"
)
DEFAULT = (
    "INSERT INTO experiments (experiment_id, name, lifecycle_stage, workspace) "
    "VALUES (0, 'x', 'active', 'default')"
)


def test_a_store_of_an_older_mlflow_is_used_with_all_that_it_has(output_dir):
    store_with_runs(output_dir)
    older_store(output_dir / "mlflow.db")
    execute(output_dir / "mlflow.db", DEFAULT, FOREIGN_RUN)
    sync_stored(output_dir)
    assert stored(output_dir) == [0, 1, 2]
    assert store(output_dir).get_run("a").info.status == "RUNNING"
    assert not list(output_dir.glob("*replaced*"))


@pytest.mark.parametrize("case", ["newer", "moved"])
def test_a_store_that_has_runs_of_others_or_can_t_be_read_is_never_replaced(output_dir, case):
    database = output_dir / "mlflow.db"
    if case == "newer":
        directory = finished_run(output_dir)
        execute(database, "UPDATE alembic_version SET version_num = 'ffffffffffff'")
    else:
        directory = finished_run(output_dir)
        sync(directory)
        execute(database, FOREIGN_RUN, "UPDATE experiment_tags SET value = '/elsewhere'")
    before = database.read_bytes()
    sentence = "move it away, and the next command makes one from the run directories"
    with pytest.raises(StoreError, match=sentence) as refusal:
        sync(directory)
    assert str(database) in str(refusal.value)
    assert database.read_bytes() == before
    assert not list(output_dir.glob("*replaced*"))


def test_a_disk_that_is_full_while_a_store_is_made_leaves_no_store_under_its_name(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, limits[1]))
    try:
        with pytest.raises(Exception, match="disk"):
            connect(default_uri(tmp_path))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert names_in(tmp_path) == [".mlflow.db.lock"]


def test_a_database_of_another_program_stays_where_it_is(tmp_path):
    database = tmp_path / "other.db"
    execute(
        database,
        "CREATE TABLE alembic_version (version_num TEXT)",
        "INSERT INTO alembic_version VALUES ('1')",
    )
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
    assert run_code(code).stderr == ""

"""Connect to an MLflow store: without hanging, initialised once, with a lock that its writers share.

The embedded store is a sqlite database. It takes one writer at a time and tells a second one that waits too long
"database is locked" (MLflow has it wait for 20 s, whatever the URL says), so that our writers queue for a lock file
beside the database. Its journal stays sqlite's own rollback journal: a write-ahead log would let readers pass while a
row is written, which takes milliseconds, but needs memory that is shared between processes, which network file systems
do not have. Readers (`mlflow ui`) need no lock of ours.
"""

import logging
import os
import sqlite3
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from parking_exp.config.credentials import with_password
from parking_exp.config.paths import SQLITE, database
from parking_exp.errors import StoreError
from parking_exp.tracking.relocation import relocate

if TYPE_CHECKING:
    from mlflow import MlflowClient

WAIT_S = 120  # for other writers
ENVIRONMENT = {
    "MLFLOW_DISABLE_TELEMETRY": "true",  # nothing leaves the machine
    "GIT_PYTHON_REFRESH": "quiet",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",  # for each run that ends
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    # MLflow's own 7 tries with doubling pauses take 4 minutes on a port where nobody listens. These take 2.3 s, and
    # what they do not reach is sent later anyway.
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "30",  # [s], of one answer
    "PGCONNECT_TIMEOUT": "10",  # [s]
    # A kept connection would go on writing into a database file that was deleted or replaced meanwhile.
    "MLFLOW_SQLALCHEMYSTORE_POOLCLASS": "NullPool",
}


def import_mlflow() -> None:
    """Import mlflow, with what it reads from the environment at that time."""
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    import mlflow  # noqa: F401


def connect(uri: str) -> "MlflowClient":
    """Return a client of a store that has answered; a store that is new is initialised.

    Raises:
        Exception: whatever MLflow, SQLAlchemy or the disk say; `failures.reason` makes a sentence of it.
    """
    import_mlflow()
    from mlflow import MlflowClient

    for name in ("alembic", "mlflow"):
        logging.getLogger(name).setLevel(logging.WARNING)
    logging.getLogger("mlflow.store").setLevel(logging.CRITICAL)  # it prints the traceback of what it raises
    if path := database(uri):
        path.parent.mkdir(parents=True, exist_ok=True)
    # Processes that open a fresh sqlite store at once collide in its migrations: one does it, the others wait.
    with write_lock(uri):
        if path is not None and os.access(path.parent, os.W_OK) and (not path.exists() or _is_half_made(path)):
            _make_database(path.resolve())
        uri = with_password(uri)
        if not uri.startswith(("http", "databricks")):
            _open_database(uri)
        client = MlflowClient(uri)
        client.search_experiments(max_results=1)
        if path is not None and os.access(path, os.W_OK):
            relocate(path)
    return client


def write_lock(uri: str) -> AbstractContextManager[Any]:
    """Return the lock that all writers to an embedded store share; other stores have their own."""
    path = database(uri)
    if path is None or (path.exists() and not os.access(path.parent, os.W_OK)):  # who can't write may still read
        return nullcontext()
    return FileLock(path.with_name(f".{path.name}.lock"), timeout=WAIT_S, poll_interval=0.01)


def _make_database(path: Path) -> None:
    """Make an empty store: MLflow's migrations are not atomic in sqlite, so the whole file is renamed into place."""
    from mlflow import MlflowClient

    if {"'", '"'} <= set(str(Path.cwd())):  # MLflow writes it into SQL as Python's repr of it
        raise StoreError(
            "MLflow can't make a store in a working directory with both ' and \" in its path; change to another"
        )
    new = path.with_name(f".{path.name}.new")
    _delete_database(new)  # a process that was killed may have left one
    try:
        MlflowClient(f"{SQLITE}{new}").search_experiments(max_results=1)
        _delete_database(path)  # a journal of the old file would be rolled back into the new one
        new.replace(path)
    finally:
        _delete_database(new)


def _delete_database(path: Path) -> None:
    for file in (path, path.with_name(f"{path.name}-journal")):
        file.unlink(missing_ok=True)


def _is_half_made(path: Path) -> bool:
    """Return whether making a store was interrupted: its migrations did not reach their head, and it holds nothing.

    MLflow can't complete such a database.
    """
    with closing(sqlite3.connect(path)) as connection:
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not tables:
            return True
        for table in tables - {"alembic_version", "workspaces"}:
            user_made = "WHERE experiment_id != 0" if table == "experiments" else ""
            if connection.execute(f'SELECT 1 FROM "{table}" {user_made} LIMIT 1').fetchone():
                return False
        versions = connection.execute("SELECT * FROM alembic_version") if "alembic_version" in tables else []
        return "experiments" in tables and [version for (version,) in versions] != [_newest_version()]


def _newest_version() -> str | None:
    """Return the revision at the head of MLflow's migrations."""
    import mlflow
    from alembic.script import ScriptDirectory

    return ScriptDirectory(str(Path(mlflow.__file__).parent / "store" / "db_migrations")).get_current_head()


def _open_database(uri: str) -> None:
    """Raise now where a database can't be opened: MLflow itself tries for two minutes before it says so."""
    from sqlalchemy import create_engine, inspect

    engine = create_engine(uri)
    try:
        inspect(engine).get_table_names()
    finally:
        engine.dispose()

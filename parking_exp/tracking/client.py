"""Connect to an MLflow store: without hanging, and with a lock that the writers of an embedded store share.

The embedded store is a sqlite database. It takes one writer at a time, and MLflow has a second one wait for 20 s before
it fails with "database is locked", so our writers queue for a lock file beside the database. Its journal stays sqlite's
own rollback journal: a write-ahead log needs memory shared between processes, which network file systems lack.
Readers (`mlflow ui`) need no lock of ours.
"""

import logging
import os
import sqlite3
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from parking_exp.config.credentials import strip_password, with_password
from parking_exp.config.paths import SQLITE, database
from parking_exp.errors import ParkingError
from parking_exp.tracking.relocation import relocate

if TYPE_CHECKING:
    from mlflow import MlflowClient

WAIT_S = 120  # for other writers
LONGEST_REASON = 200
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
    """Return a client of a store that has answered; an embedded store is made if it is not there.

    Raises:
        Exception: whatever MLflow, SQLAlchemy or the disk raise; `reason` makes a sentence of it.
    """
    import_mlflow()
    for name in ("alembic", "mlflow"):
        logging.getLogger(name).setLevel(logging.WARNING)
    logging.getLogger("mlflow.store").setLevel(logging.CRITICAL)  # it prints the traceback of what it raises
    path = database(uri)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
    with write_lock(uri):  # processes that make the same store at once collide in MLflow's migrations
        may_write = path is not None and os.access(path.parent, os.W_OK)
        if path is not None and may_write and not path.exists():
            _make_database(path.resolve())
        try:
            client = _open(uri)
        except Exception:
            if path is None or not may_write or not _is_half_made(path):
                raise
            _make_database(path.resolve())
            client = _open(uri)
        if path is not None and os.access(path, os.W_OK):
            relocate(path)
    return client


def write_lock(uri: str) -> AbstractContextManager[Any]:
    """Return the lock that all writers to an embedded store share; other stores have their own."""
    path = database(uri)
    if path is None or (path.exists() and not os.access(path.parent, os.W_OK)):  # who can't write may still read
        return nullcontext()
    return FileLock(path.with_name(f".{path.name}.lock"), timeout=WAIT_S, poll_interval=0.01)


def reason(error: BaseException) -> str:
    """Return why a store failed in one line, without passwords: what the system or sqlite said, if either did."""
    if isinstance(error, ParkingError):
        return strip_password(str(error))
    causes = [error]
    while (cause := causes[-1].__cause__ or causes[-1].__context__) and cause not in causes:
        causes.append(cause)
    known = [cause for cause in causes if isinstance(cause, OSError | sqlite3.Error)]
    cause = known[-1] if known else error
    words = getattr(cause, "strerror", None) or str(cause) or type(cause).__name__
    if isinstance(cause, OSError) and cause.filename:
        words += f": {cause.filename}"
    words = strip_password(" ".join(words.split()))
    return words if len(words) <= LONGEST_REASON else f"{words[:LONGEST_REASON]}..."


def _make_database(path: Path) -> None:
    """Make an empty store: MLflow's migrations are not atomic in sqlite, so the whole file is renamed into place."""
    from mlflow import MlflowClient

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
    """Return whether a database that can't be opened is a store that holds nothing: MLflow was interrupted making it.

    MLflow can't complete such a database.
    """
    with closing(sqlite3.connect(path)) as connection:
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for table in tables - {"alembic_version", "workspaces"}:
            user_made = "WHERE experiment_id != 0" if table == "experiments" else ""
            if connection.execute(f'SELECT 1 FROM "{table}" {user_made} LIMIT 1').fetchone():
                return False
        return not tables or "experiments" in tables


def _open(uri: str) -> "MlflowClient":
    """Return a client of a store that has answered."""
    from mlflow import MlflowClient
    from sqlalchemy import create_engine, inspect

    uri = with_password(uri)
    if not uri.startswith(("http", "databricks")):  # MLflow tries for two minutes before it raises
        engine = create_engine(uri)
        try:
            inspect(engine).get_table_names()
        finally:
            engine.dispose()
    client = MlflowClient(uri)
    client.search_experiments(max_results=1)
    return client

"""Connect to an MLflow store without hanging, with a lock that the writers of a sqlite store share.

A sqlite store takes one writer at a time. With MLflow, a second writer waits for 20 s and fails
with "database is locked". So our writers queue for a lock file beside the database. The database
keeps sqlite's rollback journal, since a write-ahead log needs shared memory, which network file
systems lack. Readers (`mlflow ui`) need no lock.
"""

import logging
import os
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from parking_exp.config.paths import SQLITE, database_file
from parking_exp.garbage_collection import no_garbage_collection
from parking_exp.terminal import say

if TYPE_CHECKING:
    from mlflow import MlflowClient

WAIT_S = 120  # for other writers
ENVIRONMENT = {
    "MLFLOW_DISABLE_TELEMETRY": "true",  # nothing leaves the machine
    "GIT_PYTHON_REFRESH": "quiet",
    "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",  # for each run that ends
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    # MLflow's 7 tries with doubling pauses take 4 minutes on a closed port; these take 2.3 s.
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "30",  # [s], of one answer
    "PGCONNECT_TIMEOUT": "10",  # [s]
    # A kept connection would keep writing into a database file that was deleted or replaced
    # meanwhile.
    "MLFLOW_SQLALCHEMYSTORE_POOLCLASS": "NullPool",
}


def import_mlflow() -> None:
    """Import mlflow, after setting the environment variables that it reads on import."""
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    # A user of a container may have no home, for which mlflow's import fails.
    if os.path.expanduser("~") == "~":  # noqa: PTH111 (the other way raises)
        os.environ["HOME"] = "/nonexistent"
    import mlflow  # noqa: F401

    for name in ("alembic", "mlflow"):
        logging.getLogger(name).setLevel(logging.WARNING)
    # It prints the traceback of what it raises.
    logging.getLogger("mlflow.store").setLevel(logging.CRITICAL)


@cache
def say_ignored_store() -> None:
    """Say once that `MLFLOW_TRACKING_URI` is ignored.

    If it chose the store, other people's run directories would be sent there.
    """
    if os.environ.get("MLFLOW_TRACKING_URI"):
        say(
            "MLFLOW_TRACKING_URI is ignored; tracking.uri=URI chooses a store other than "
            "output_dir's",
            stderr=True,
        )


def connect(uri: str) -> "MlflowClient":
    """Connect to a store, and check that it answers; make a sqlite database if there is none.

    Raises whatever MLflow, SQLAlchemy or the disk raise; `reason_of_store_failure` makes it one
    line.
    """
    with no_garbage_collection():
        import_mlflow()
        path = database_file(uri)
        if path is not None and not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            # Processes that make the same store at once collide in MLflow's migrations.
            with write_lock(uri):
                if not path.exists():
                    _make_database(path)
        return _open_client(uri)


def write_lock(uri: str) -> AbstractContextManager[Any]:
    """Return the lock that all writers to a sqlite store share; other stores have their own."""
    path = database_file(uri)
    if path is None:
        return nullcontext()
    lock = lock_path(path)
    # Where no file can be made, as in /proc, FileLock would try again until its timeout.
    os.close(os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644))
    return FileLock(lock, timeout=WAIT_S, poll_interval=0.01)


def lock_path(path: Path) -> Path:
    """Return the lock file of a sqlite store."""
    return path.with_name(f".{path.name}.lock")


def _make_database(path: Path) -> None:
    """Make an empty store by renaming a new one: MLflow's migrations are not atomic in sqlite."""
    from mlflow import MlflowClient

    new = path.with_name(f".{path.name}.new")
    leftovers = (new, Path(f"{new}-journal"))  # left by a process that was killed
    # Sqlite would apply an old journal to the new database.
    for file in (*leftovers, Path(f"{path}-journal")):
        file.unlink(missing_ok=True)
    try:
        MlflowClient(f"{SQLITE}{new}").search_experiments(max_results=1)
        new.replace(path)
    finally:
        for file in leftovers:
            file.unlink(missing_ok=True)


def _open_client(uri: str) -> "MlflowClient":
    """Return a client of a store that exists, once it has answered."""
    from mlflow import MlflowClient
    from sqlalchemy import create_engine, inspect

    if not uri.startswith(("http", "databricks")):  # MLflow tries for two minutes before it raises
        engine = create_engine(uri)
        try:
            inspect(engine).get_table_names()
        finally:
            engine.dispose()
    client = MlflowClient(uri)
    client.search_experiments(max_results=1)
    return client

"""Tell failures of a store from errors of this package, and say in a sentence what failed."""

import sqlite3
from collections.abc import Iterator
from socket import gaierror
from traceback import walk_tb

from parking_exp.config.credentials import strip_password
from parking_exp.errors import DISK_ERRORS, ParkingError

LONGEST_REASON = 200
# Packages whose exceptions are failures of a store: MLflow, its database drivers, its clients of artifact storage.
STORE_PACKAGES = {
    "mlflow", "sqlalchemy", "alembic", "psycopg2", "pymysql", "requests", "urllib3",
    "boto3", "botocore", "google", "azure", "paramiko", "pysftp", "databricks",
}  # fmt: skip
# What provides a module that is not called as it is, where MLflow or SQLAlchemy need it.
PROVIDERS = {
    "psycopg2": "psycopg2-binary", "MySQLdb": "mysqlclient", "google": "google-cloud-storage",
    "azure": "azure-storage-blob azure-identity", "databricks": "databricks-sdk",
}  # fmt: skip


def is_store_failure(error: BaseException) -> bool:
    """Whether an error comes from a store, its disk or its network, or says in a sentence what is wrong with a run.

    Anything else is an error of this package.
    """
    if isinstance(error, ImportError):  # of a driver, which is imported when it is needed
        modules = [frame.f_globals.get("__name__", "") for frame, _ in walk_tb(error.__traceback__)]
    else:
        modules = [type(error).__module__]
    of_system = isinstance(error, ConnectionError | TimeoutError | gaierror) or (
        isinstance(error, OSError) and error.errno in DISK_ERRORS
    )
    return of_system or isinstance(error, sqlite3.Error | ParkingError) or any(map(_is_of_store, modules))


def reason(error: BaseException) -> str:
    """Say in one sentence what a store's error came from, without passwords."""
    if isinstance(error, ParkingError):  # a sentence already
        return strip_password(str(error))
    if isinstance(error, ModuleNotFoundError) and error.name:
        package = error.name.partition(".")[0]
        return f"the package {package!r} is not installed: pip install {PROVIDERS.get(package, package)}"
    chain = list(_chain(error))
    causes = [getattr(link, "orig", link) for link in chain]  # SQLAlchemy wraps the driver's error
    known = [cause for cause in causes if isinstance(cause, OSError | sqlite3.Error) or "psycopg" in str(type(cause))]
    cause = known[-1] if known else error
    words = getattr(cause, "strerror", None) or str(getattr(cause, "reason", None) or cause) or type(cause).__name__
    if isinstance(cause, OSError) and cause.filename:
        words += f": {cause.filename}"
    words = strip_password(" ".join(words.split()))
    return words if len(words) <= LONGEST_REASON else f"{words[:LONGEST_REASON]}..."


def _is_of_store(module: str) -> bool:
    return module.partition(".")[0] in STORE_PACKAGES


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or error.__context__

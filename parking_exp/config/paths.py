"""Paths and URIs of outputs, runs and stores, relative so that an output directory can move."""

import os
import re
from collections.abc import Iterable
from pathlib import Path
from urllib.parse import unquote, urlparse

from parking_exp.errors import ConfigError, UntrustedError

SQLITE = "sqlite:///"
ARTIFACTS = "mlflow-artifacts"  # folder of an output directory
PARAMETERS = (
    "application_name|charset|client_encoding|connect_timeout|driver|encrypt|gssencmode|host|"
    "passfile|port|read_default_file|read_default_group|service|ssl_ca|ssl_cert|ssl_key|sslcert|"
    "sslkey|sslmode|sslrootcert|target_session_attrs|trusted_connection|trustservercertificate|"
    "unix_socket"
)
"""Parameters of database drivers whose values are not secret."""
# A sqlite file; a URI with neither user, query, fragment nor parameters; or one of a database,
# whose user, if any, has no password, and whose parameters, if any, are not secret.
WITHOUT_SECRET = re.compile(
    rf"""sqlite:///.*
    | [^@?#;]*
    | (postgresql|mysql|mssql)(\+\w+)?:// ([^:@/?#;%]+@)? [^@?#;]*
      (\?(({PARAMETERS})=[^&@;%]*(&|$))+)?
    """,
    re.VERBOSE | re.IGNORECASE | re.DOTALL,
)


def refuse_password(uri: str) -> str:
    """Refuse a URI that may contain a password or token, and return any other.

    Raises:
        ConfigError: it may contain a secret, which would be stored with the run and shown in the
            list of processes.
    """
    if not WITHOUT_SECRET.fullmatch(uri):
        raise ConfigError(
            "the URI contains what may be a secret; set it in the environment (PGPASSWORD, "
            "MLFLOW_TRACKING_USERNAME and MLFLOW_TRACKING_PASSWORD, or MLFLOW_TRACKING_TOKEN)"
        )
    return uri


def absolute_path(text: str | Path) -> Path:
    """Return an absolute path, `~` and `..` resolved, but not symbolic links."""
    # `Path.expanduser` raises for an unknown user.
    return Path(os.path.normpath(Path(os.path.expanduser(text)).absolute()))  # noqa: PTH111


def refuse_question_mark(path: Path) -> None:
    """Refuse a path that a sqlite URI can't have.

    Raises:
        ConfigError: it has a question mark, at which such a URI ends.
    """
    if "?" in str(path):
        raise ConfigError(
            f"{path} has a question mark, at which the URI of a sqlite store ends; choose another "
            "path"
        )


def default_uri(output_dir: Path) -> str:
    """Return the URI of the embedded store of an output directory."""
    return f"{SQLITE}{output_dir / 'mlflow.db'}"


def absolute_uri(uri: str, base: Path | None = None) -> str:
    """Return a URI whose sqlite path is absolute.

    A relative path starts at the base directory, or at the working directory.
    """
    path = database_file(uri)
    return uri if path is None else f"{SQLITE}{absolute_path((base or Path()) / path)}"


def relative_uri(uri: str, base: Path) -> str:
    """Return a URI with its sqlite path relative to a base directory, if it is below it."""
    path = database_file(absolute_uri(uri))
    return uri if path is None else f"{SQLITE}{relative_path(path, base)}"


def relative_path(path: Path, base: Path) -> str:
    """Return a path relative to a base directory if it is below it, else the absolute path."""
    path = absolute_path(path)
    base = absolute_path(base)
    if path.is_relative_to(base):
        path = path.relative_to(base)
    return str(path)


def database_file(uri: str) -> Path | None:
    """Return the file of a sqlite store, None for any other."""
    return Path(uri.removeprefix(SQLITE)) if uri.startswith(SQLITE) else None


def local_folder(uri: str) -> Path | None:
    """Return the local folder of a URI of artifacts; None if they are on a server."""
    parts = urlparse(uri)
    if parts.scheme == "file" and parts.netloc in ("", "localhost"):
        return Path(unquote(parts.path))
    return None if parts.scheme else Path(uri)


def is_same_store(uri: str, other_uri: str) -> bool:
    """Return whether two URIs name the same store."""
    file = database_file(uri)
    other_file = database_file(other_uri)
    if file is None or other_file is None:
        return uri == other_uri
    return resolved(file) == resolved(other_file)


def resolved(path: Path) -> Path:
    """Return a path with all links followed; unlike `Path.resolve`, accept links to themselves."""
    return Path(os.path.realpath(path))


def lies_inside(path: Path, folder: Path) -> bool:
    """Return whether a path is below a folder once all symbolic links are followed."""
    return resolved(path).is_relative_to(resolved(folder))


def refuse_links(paths: Iterable[Path], folder: Path) -> None:
    """Refuse symbolic links out of a folder: files elsewhere would be read, written or sent.

    Links that lead nowhere, pipes and devices are refused as well: opening a pipe waits for ever.

    Raises:
        UntrustedError: one of the paths is such a link or file.
    """
    for path in paths:
        if path.is_symlink() and not lies_inside(path, folder):
            raise UntrustedError(f"{path} is a symbolic link that leads out of {folder}; remove it")
        if path.is_symlink() and not path.exists():
            raise UntrustedError(f"{path} is a symbolic link that leads nowhere; remove it")
        if path.exists() and not path.is_file() and not path.is_dir():
            raise UntrustedError(f"{path} is neither a file nor a directory; remove it")

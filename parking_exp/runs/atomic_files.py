"""Atomic writes of files, and reads of JSON and YAML."""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from parking_exp.errors import first_line


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Yield a path to write to; at the end of the block that file replaces `path`.

    After a kill, an error or on a full disk, the file has the old or the new content; after a power cut, if `durable`.
    """
    temporary = path.with_name(f".tmp-{os.getpid()}-{path.name}")  # two processes may write at once; the last one wins
    try:
        yield temporary
        if durable:
            fsync(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_atomically(path: Path, text: str, *, durable: bool = True) -> None:
    """Replace a text file; see `replacing`."""
    with replacing(path, durable=durable) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any, *, durable: bool = True) -> None:
    """Write JSON atomically."""
    write_atomically(path, json.dumps(value, indent=2) + "\n", durable=durable)


def read_json(path: Path) -> Any:
    """Read a JSON file; return None if it does not exist. Raises ValueError for other content."""
    try:
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    except RecursionError as error:
        raise ValueError(f"{path} is nested too deeply") from error


def read_plain_yaml(path: Path) -> Any:
    """Read a YAML file that holds what JSON has; raises ValueError for a tag or a date."""
    try:
        return json.loads(json.dumps(yaml.safe_load(path.read_text(encoding="utf-8"))))
    except (yaml.YAMLError, RecursionError, LookupError, AttributeError, TypeError) as error:
        raise ValueError(first_line(error)) from error


def read_object(path: Path) -> dict[str, Any]:
    """Read a JSON object; return {} if the file does not exist or holds anything else."""
    try:
        content = read_json(path)
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def fsync(path: Path) -> None:
    """Wait until a file or directory is on the disk (`os.fsync`)."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

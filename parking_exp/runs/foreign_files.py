"""Read files that other people may have made.

Pipes, devices and files that are too large are refused.
"""

import errno
import hashlib
import json
import os
import stat
import sys
from io import BufferedReader
from pathlib import Path
from typing import Any

import yaml

from parking_exp.errors import first_line

MAX_SMALL = 2**20  # bytes of a YAML file, which is parsed slowly
MAX_JSON = 2**26
MAX_DEPTH = 100  # levels of YAML: the C parser calls itself at each
MAX_LARGE = 2**31  # for a log, a model or a video
# PyYAML's parser in C takes a tenth of the time; PyYAML may have been built without it.
_YamlLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_json(path: Path) -> Any:
    """Read a JSON file; return None if it does not exist. Raises ValueError for other content."""
    if not path.exists():
        return None
    try:
        return json.loads(read_file(path, MAX_JSON))
    except RecursionError as error:
        raise ValueError(f"{path} is nested too deeply") from error


def parse_plain_yaml(content: bytes) -> Any:
    """Parse YAML that has only values of JSON.

    Raises:
        ValueError: it is too large or damaged, or has other values or aliases.
    """
    if len(content) > MAX_SMALL:
        raise ValueError(f"it has more than {MAX_SMALL:,} bytes")
    try:
        _refuse_unusual_yaml(content)
        return json.loads(json.dumps(yaml.load(content, _YamlLoader)))
    except (yaml.YAMLError, RecursionError, LookupError, AttributeError, TypeError) as error:
        raise ValueError(first_line(error)) from error


def _refuse_unusual_yaml(content: bytes) -> None:
    """Raise YAMLError for deep nesting, and for aliases: with them, a few lines fill the memory."""
    depth = 0
    for event in yaml.parse(content, _YamlLoader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias; stored configs have values only")
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            raise yaml.YAMLError("it is nested too deeply")


def read_file(path: Path, limit: int = MAX_LARGE) -> bytes:
    """Return the content of a file.

    Raises:
        OSError: it can't be read, has more bytes than the limit, or is a pipe or a device, which
            might never end.
    """
    with open_file(path, limit) as file:
        return file.read()


def open_file(path: Path, limit: int = MAX_LARGE) -> BufferedReader:
    """Open a file for reading.

    Raises:
        OSError: see `read_file`.
    """
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb")
    status = os.fstat(file.fileno())
    if not stat.S_ISREG(status.st_mode):
        file.close()
        raise OSError(errno.EINVAL, "It is not a file", str(path))
    if status.st_size > limit:
        file.close()
        raise OSError(errno.EFBIG, f"It has more than {limit:,} bytes", str(path))
    return file


def read_object(path: Path) -> dict[str, Any]:
    """Read a JSON object; return {} if the file does not exist or holds anything else."""
    try:
        content = read_json(path)
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hex.

    The file may be of any size, as the replay buffer of a checkpoint is. Otherwise raises as
    `read_file`.
    """
    with open_file(path, sys.maxsize) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

"""Write files atomically."""

import gzip
import json
import os
import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

HOST = re.sub(r"[^A-Za-z0-9]", "", socket.gethostname())


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Yield a temporary path to write to, which replaces `path` at the end of the block.

    A kill, an error or a full disk leaves either the old or the new content. With `durable`, so
    does a power cut.
    """
    _remove_leftovers(path.parent)
    # Two processes, of different machines even, may write at once; the last one wins.
    temporary = path.with_name(f".tmp-{HOST}-{os.getpid()}-{path.name}")
    try:
        yield temporary
        if durable:
            fsync(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _remove_leftovers(folder: Path) -> None:
    """Remove the temporary files of processes of this machine that were killed."""
    for leftover in folder.glob(f".tmp-{HOST}-*"):
        pid = leftover.name.removeprefix(f".tmp-{HOST}-").partition("-")[0]
        if pid.isdecimal() and not _is_alive(int(pid)):
            with suppress(OSError):  # another process has removed it, or it is a directory
                leftover.unlink()


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # the process belongs to another user
        return True
    return True


def write_atomically(path: Path, text: str, *, durable: bool = True) -> None:
    """Replace a text file; see `replacing`."""
    with replacing(path, durable=durable) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_gzip(path: Path, text: str) -> None:
    """Replace a gzipped text file. Equal texts have equal bytes: the time is always the same."""
    with replacing(path) as temporary:
        temporary.write_bytes(gzip.compress(text.encode(), mtime=1))


def write_json(path: Path, value: Any, *, durable: bool = True) -> None:
    """Write JSON atomically."""
    write_atomically(path, json.dumps(value, indent=2) + "\n", durable=durable)


def fsync(path: Path) -> None:
    """Wait until a file or directory is on the disk (`os.fsync`)."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

"""Lock files that keep processes apart. The system releases a lock when its process ends, however that ends."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from parking_exp.errors import RunLockedError


@contextmanager
def hold(path: Path, patience_s: float) -> Iterator[None]:
    """Hold a lock file.

    Raises:
        RunLockedError: another process has held it all the while.
    """
    try:
        lock = FileLock(path).acquire(timeout=patience_s)
    except Timeout:
        raise RunLockedError(f"another process is working on {path.parent}; wait for it, or stop it first") from None
    with lock:
        yield


def is_held(path: Path) -> bool:
    """Whether a process holds a lock file. A shared lock is tried, so that several may look at once."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:  # it was never locked
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False

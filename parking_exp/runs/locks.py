"""Lock files: whether a process holds one."""

import fcntl
import os
from pathlib import Path


def is_held(path: Path) -> bool:
    """Return whether a process holds a lock file. The system releases it when the process ends."""
    try:
        # A pipe in its place would wait for a writer.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError:  # it was never locked
        return False
    try:
        # Shared, so that several may look at once.
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False

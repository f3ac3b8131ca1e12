"""Worker processes: forks of `fork_server`, which has torch, or fresh where forks are unsafe."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from parking_exp.sweeps.resources import THREAD_VARIABLES
from parking_exp.sweeps.worker import work

StartMethod = Literal["spawn", "forkserver"]
"""How `multiprocessing` starts a process: afresh, or as a fork of the server that this process has
started.
"""

# On macOS, system libraries do not survive a fork.
LOCAL_START_METHOD: StartMethod = "spawn" if sys.platform == "darwin" else "forkserver"
SERVER_LOST = 255  # exit status of a process whose server was killed
# To start a process, `multiprocessing` polls the exit status of all others, without a lock.
_LOCK = threading.Lock()


class WorkerProcess:
    """A process that trains one run. Each object is used by one thread.

    Args:
        path: the run directory, with its config.
        cores: the cores that it may use, with a thread each. If empty, it may use all.
        device: the CUDA device that it may use; by default all.
        start_method: how it starts.
    """

    def __init__(
        self, path: Path, cores: Sequence[int], device: str | None, start_method: StartMethod
    ) -> None:
        with _LOCK:  # `start` changes it for a moment
            environment = dict(os.environ)
        if cores:
            environment |= dict.fromkeys(THREAD_VARIABLES, str(len(cores)))
        if device is not None:
            environment["CUDA_VISIBLE_DEVICES"] = device
        context: Any = multiprocessing.get_context(start_method)
        self._process = context.Process(target=work, args=(path, cores, environment))

    def start(self) -> None:
        """Start the process, and first the fork server if it is not running yet."""
        # Both import the same package as this process, wherever that was found.
        same_imports = {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONSAFEPATH": "1"}
        with _LOCK, _environment(same_imports), _hidden_program():
            multiprocessing.set_forkserver_preload(["parking_exp.sweeps.fork_server"])
            self._process.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def exit_status(self) -> int | None:
        """None while it runs; -N if signal N has ended it."""
        with _LOCK:
            return self._process.exitcode

    def terminate(self) -> None:
        """Ask it to stop, by SIGTERM."""
        self._process.terminate()

    def kill(self) -> None:
        """Kill it with its children, and wait for it."""
        try:
            os.killpg(self.pid, signal.SIGKILL)
        except ProcessLookupError:  # it does not lead a group of its own yet
            self._process.kill()
        with _LOCK:
            self._process.join()


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables within a block."""
    before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        for name in variables:
            del os.environ[name]
        os.environ.update(before)


@contextmanager
def _hidden_program() -> Iterator[None]:
    """Hide this process's program from `multiprocessing`: workers would rerun a user's script."""
    program = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = program

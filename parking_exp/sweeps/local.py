"""The local launcher: a pool of workers on this machine, each with cores and CUDA devices of its own."""

import os
import queue
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from parking_exp.errors import InterruptedRunError
from parking_exp.resources import cores, cuda_devices, free_memory, memory_of, shares
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.state import read_state
from parking_exp.sweeps.supervisor import WorkerResources, WorkerResult, supervise
from parking_exp.terminal import say
from parking_exp.training.signals import stop_on_signal

GIB = 2**30
DEFAULT_MEMORY = GIB  # of a run, before any has finished
MEMORY_POLL_S = 0.5


def launch(
    paths: Sequence[Path], n_jobs: int | None = None, memory_gb: float | None = None
) -> dict[Path, WorkerResult]:
    """Train runs, up to `n_jobs` at a time; return how each ended that was begun.

    Each worker has cores of its own, and CUDA devices in turn where there are any. A run starts when there is memory
    for it, or when no other is under way. The first SIGINT or SIGTERM stops them all, with their states saved; a second
    one leaves at once.

    Args:
        paths: run directories with frozen configs.
        n_jobs: how many at a time; None: as many as there are cores.
        memory_gb: what a run needs, in GiB; None: as much as the last finished ones took.

    Raises:
        InterruptedRunError: a signal stopped it.
    """
    if not paths:
        return {}
    pool = _Pool(paths, min(n_jobs or len(cores()), len(paths)), memory_gb)
    with stop_on_signal("checkpoints", pool.stop.set, _leave) as request:
        pool.run()
    if request.signal_number is not None:
        words = "stopped; what was under way is saved; type the same command to go on"
        raise InterruptedRunError(words, request.signal_number)
    return pool.results


class _Pool:
    """Queued runs, and the workers that take them."""

    def __init__(self, paths: Sequence[Path], n_workers: int, memory_gb: float | None) -> None:
        self.memory_gb = memory_gb
        self.waiting: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for path in paths:
            self.waiting.put(path)
        self.stop = threading.Event()
        self.results: dict[Path, WorkerResult] = {}
        self._under_way: dict[int, int | None] = {}  # worker -> pid, once it has one
        self._entrance = threading.Lock()
        devices = cuda_devices()
        self.workers = [
            WorkerResources(some, [devices[number % len(devices)]] if devices else None)
            for number, some in enumerate(shares(cores(), n_workers))
        ]

    def run(self) -> None:
        """Work until nothing waits, or all is stopped."""
        threads = [
            threading.Thread(target=self._work, args=(worker,), daemon=True) for worker in range(len(self.workers))
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            while thread.is_alive():  # in short waits, so that signals are heard
                thread.join(0.2)

    def _work(self, worker: int) -> None:
        while (path := self._next(worker)) is not None:
            try:
                self.results[path] = supervise(path, self.workers[worker], self.stop, self._started(worker))
            except Exception as error:  # its directory can't be written, say; the others go on
                say(f"error: {path}: {type(error).__name__}: {error}", stderr=True)
                self.results[path] = "failed"
                with suppress(Exception):
                    RunDirectory(path).update(status="failed", error=f"{type(error).__name__}: {error}")
            finally:
                self._under_way.pop(worker, None)

    def _next(self, worker: int) -> Path | None:
        """Wait for memory, and return the next run; None when there is none."""
        with self._entrance:  # one at a time: two could both count on the same free memory
            while not self.stop.is_set() and not self.waiting.empty():
                if self._has_memory():
                    self._under_way[worker] = None
                    return self.waiting.get()
                time.sleep(MEMORY_POLL_S)
        return None

    def _has_memory(self) -> bool:
        """Whether one more run fits beside those under way, when these have grown to their full size."""
        if not self._under_way:
            return True
        need = self._need()
        used = (memory_of(pid) if pid else 0 for pid in list(self._under_way.values()))
        promised = sum(max(0, need - one) for one in used)
        return free_memory() - promised >= need

    def _need(self) -> int:
        if self.memory_gb is not None:
            return int(self.memory_gb * GIB)
        finished = [path for path, result in list(self.results.items()) if result == "done"]
        return max(
            (read_state(path).memory_bytes or 0 for path in finished[-len(self.workers) :]), default=DEFAULT_MEMORY
        )

    def _started(self, worker: int) -> Callable[[subprocess.Popen[bytes]], None]:
        def note(process: subprocess.Popen[bytes]) -> None:
            self._under_way[worker] = process.pid

        return note


def _leave(number: int) -> None:
    os._exit(128 + number)  # workers die with their supervisor

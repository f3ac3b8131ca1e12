"""The local launcher: a pool of workers on this machine, each with cores and CUDA devices of its own."""

import os
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from parking_exp.errors import InterruptedRunError
from parking_exp.resources import cores, cuda_devices, free_memory, memory_of, shares
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.state import read_state
from parking_exp.sweeps.supervisor import Stop, WorkerResources, WorkerResult, supervise
from parking_exp.terminal import say
from parking_exp.training.signals import stop_on_signal

GIB = 2**30
DEFAULT_MEMORY = GIB  # of a run, before any has finished
MEMORY_POLL_S = 0.5


Train = Callable[[Path, Stop | None], WorkerResult | None]
"""Trains the run of a directory with a worker's resources; None where all is stopped before it begins."""


def launch(
    paths: Sequence[Path], n_jobs: int | None = None, memory_gb: float | None = None
) -> dict[Path, WorkerResult]:
    """Train runs, up to `n_jobs` at a time; return how each ended that was begun.

    Args:
        paths: run directories with frozen configs.
        n_jobs: how many at a time; None: as many as there are cores.
        memory_gb: what a run needs, in GiB; None: as much as the last finished ones took.

    Raises:
        InterruptedRunError: a signal stopped it.
    """
    if not paths:
        return {}
    waiting = deque(paths)

    def work(train: Train) -> None:
        while (path := _popleft(waiting)) is not None:
            train(path, None)

    return launch_workers(work, min(n_jobs or len(cores()), len(paths)), memory_gb)


def _popleft(waiting: deque[Path]) -> Path | None:
    try:
        return waiting.popleft()
    except IndexError:
        return None


def launch_workers(
    work: Callable[[Train], None], n_workers: int, memory_gb: float | None = None
) -> dict[Path, WorkerResult]:
    """Have workers train what they choose; return how each run ended that was begun.

    Each worker has cores of its own, and CUDA devices in turn where there are any. A run starts when there is memory
    for it, or when no other is under way. The first SIGINT or SIGTERM stops them all, with their states saved; a second
    one leaves at once.

    Args:
        work: what a worker does, given the function that trains; called in a thread for each of them.
        n_workers: how many.
        memory_gb: see `launch`.

    Raises:
        InterruptedRunError: a signal stopped it.
    """
    pool = _Pool(n_workers, memory_gb)
    with stop_on_signal("checkpoints", pool.stop.set, _leave) as request:
        pool.run(work)
    if request.signal_number is not None:
        words = "stopped; what was under way is saved; type the same command to go on"
        raise InterruptedRunError(words, request.signal_number)
    return pool.results


class _Pool:
    """Workers, and what they need to train runs side by side."""

    def __init__(self, n_workers: int, memory_gb: float | None) -> None:
        self.memory_gb = memory_gb
        self.stop = threading.Event()
        self.results: dict[Path, WorkerResult] = {}
        self._under_way: dict[int, int | None] = {}  # worker -> pid, once it has one
        self._entrance = threading.Lock()
        devices = cuda_devices()
        self.workers = [
            WorkerResources(some, [devices[number % len(devices)]] if devices else None)
            for number, some in enumerate(shares(cores(), n_workers))
        ]

    def run(self, work: Callable[[Train], None]) -> None:
        """Have every worker do its work to the end; what one of them raises is raised then."""
        errors: list[BaseException] = []

        def run_one(worker: int) -> None:
            try:
                work(lambda path, stop: self._train(worker, path, stop))
            except BaseException as error:
                errors.append(error)

        threads = [threading.Thread(target=run_one, args=(worker,), daemon=True) for worker in range(len(self.workers))]
        for thread in threads:
            thread.start()
        for thread in threads:
            while thread.is_alive():  # in short waits, so that signals are heard
                thread.join(0.2)
        if errors and not self.stop.is_set():
            raise errors[0]

    def _train(self, worker: int, path: Path, stop: Stop | None) -> WorkerResult | None:
        if not self._admit(worker):
            return None
        try:
            asked = self.stop.is_set if stop is None else lambda: self.stop.is_set() or stop()
            result = supervise(path, self.workers[worker], asked, self._started(worker))
        except Exception as error:  # its directory can't be written, say; the others go on
            say(f"error: {path}: {type(error).__name__}: {error}", stderr=True)
            result = "failed"
            with suppress(Exception):
                RunDirectory(path).update(status="failed", error=f"{type(error).__name__}: {error}")
        finally:
            self._under_way.pop(worker, None)
        self.results[path] = result
        return result

    def _admit(self, worker: int) -> bool:
        """Wait until there is memory for one more run; return False where all is stopped before."""
        with self._entrance:  # one at a time: two could both count on the same free memory
            while not self.stop.is_set():
                if self._has_memory():
                    self._under_way[worker] = None
                    return True
                time.sleep(MEMORY_POLL_S)
        return False

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

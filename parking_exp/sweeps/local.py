"""The local launcher: a pool of workers on this machine, each with cores and CUDA devices of its own."""

import os
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from parking_exp.errors import InterruptedRunError
from parking_exp.resources import cores, cuda_devices, shares
from parking_exp.runs.directory import RunDirectory
from parking_exp.sweeps.supervisor import Stop, WorkerResources, WorkerResult, supervise
from parking_exp.terminal import say
from parking_exp.training.signals import stop_on_signal

Train = Callable[[Path, Stop | None], WorkerResult | None]
"""Trains the run of a directory with a worker's resources; None where all is stopped before it begins."""


def launch(paths: Sequence[Path], n_jobs: int | None = None) -> dict[Path, WorkerResult]:
    """Train runs, up to `n_jobs` at a time; return how each ended that was begun.

    Args:
        paths: run directories with frozen configs.
        n_jobs: how many at a time; None: as many as there are cores.

    Raises:
        InterruptedRunError: a signal stopped it.
    """
    if not paths:
        return {}
    waiting = deque(paths)

    def work(train: Train) -> None:
        while (path := _popleft(waiting)) is not None:
            train(path, None)

    return launch_workers(work, min(n_jobs or len(cores()), len(paths)))


def _popleft(waiting: deque[Path]) -> Path | None:
    try:
        return waiting.popleft()
    except IndexError:
        return None


def launch_workers(work: Callable[[Train], None], n_workers: int) -> dict[Path, WorkerResult]:
    """Have workers train what they choose; return how each run ended that was begun.

    Each worker has cores of its own, and CUDA devices in turn where there are any. The first SIGINT or SIGTERM stops
    them all, with their states saved; a second one leaves at once.

    Args:
        work: what a worker does, given the function that trains; called in a thread for each of them.
        n_workers: how many.

    Raises:
        InterruptedRunError: a signal stopped it.
    """
    pool = _Pool(n_workers)
    with stop_on_signal(pool.stop.set, _leave) as request:
        pool.run(work)
    if request.signal_number is not None:
        words = "stopped; what was under way is saved; rerun the same command to resume"
        raise InterruptedRunError(words, request.signal_number)
    return pool.results


class _Pool:
    """Workers, and what they need to train runs side by side."""

    def __init__(self, n_workers: int) -> None:
        self.stop = threading.Event()
        self.results: dict[Path, WorkerResult] = {}
        devices = cuda_devices()
        self.workers = [
            WorkerResources(some, [devices[number % len(devices)]] if devices else None)
            for number, some in enumerate(shares(cores(), n_workers))
        ]

    def run(self, work: Callable[[Train], None]) -> None:
        """Have every worker do its work to the end; what one of them raises is raised then."""
        errors: list[BaseException] = []

        def run_one(worker: WorkerResources) -> None:
            try:
                work(lambda path, stop: self._train(worker, path, stop))
            except BaseException as error:
                errors.append(error)

        threads = [threading.Thread(target=run_one, args=(worker,), daemon=True) for worker in self.workers]
        for thread in threads:
            thread.start()
        for thread in threads:
            while thread.is_alive():  # in short waits, so that signals are heard
                thread.join(0.2)
        if errors and not self.stop.is_set():
            raise errors[0]

    def _train(self, worker: WorkerResources, path: Path, stop: Stop | None) -> WorkerResult | None:
        if self.stop.is_set():
            return None
        try:
            asked = self.stop.is_set if stop is None else lambda: self.stop.is_set() or stop()
            result = supervise(path, worker, asked)
        except Exception as error:  # its directory can't be written, say; the others go on
            say(f"error: {path}: {type(error).__name__}: {error}", stderr=True)
            result = "failed"
            with suppress(Exception):
                RunDirectory(path).update(status="failed", error=f"{type(error).__name__}: {error}")
        self.results[path] = result
        return result


def _leave(number: int) -> None:
    os._exit(128 + number)  # workers die with their supervisor

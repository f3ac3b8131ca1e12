"""The local launcher: a pool of workers on this machine, each with its own cores and CUDA devices."""

import os
import queue
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from parking_exp.errors import InterruptedRunError
from parking_exp.resources import cores, cuda_devices, shares
from parking_exp.sweeps.supervisor import Stop, WorkerResources, WorkerResult, supervise
from parking_exp.terminal import say
from parking_exp.training.signals import stop_on_signal

Train = Callable[[Path, Stop], WorkerResult | None]
"""Trains the run of a directory; returns None if the pool was stopped before it began."""


def launch(paths: Sequence[Path], n_jobs: int | None = None) -> dict[Path, WorkerResult]:
    """Train the runs of directories, `n_jobs` at a time (None: one per core); see `launch_workers`."""
    waiting = queue.SimpleQueue[Path | None]()
    n_workers = min(n_jobs or len(cores()), len(paths))
    for path in (*paths, *[None] * n_workers):
        waiting.put(path)

    def work(train: Train) -> None:
        while (path := waiting.get()) is not None:
            train(path, lambda: False)

    return launch_workers(work, n_workers)


def launch_workers(work: Callable[[Train], None], n_workers: int) -> dict[Path, WorkerResult]:
    """Call `work` in a thread for each worker, with a function that trains; return how each run ended that was begun.

    Each worker has its own cores and, in turn, a CUDA device. The first SIGINT or SIGTERM stops them all, with their
    states saved; a second one exits at once.

    Raises:
        InterruptedRunError: a signal stopped it.
    """
    results, devices = dict[Path, WorkerResult](), cuda_devices()

    def train(worker: WorkerResources, path: Path, stop_run: Stop) -> WorkerResult | None:
        if request.is_made:
            return None
        try:
            results[path] = supervise(path, lambda: request.is_made or stop_run(), worker)
        except Exception as error:  # e.g. its directory can't be written; the other runs continue
            say(f"error: {path}: {type(error).__name__}: {error}", stderr=True)
            results[path] = "failed"
        return results[path]

    with stop_on_signal(_leave) as request, ThreadPoolExecutor(n_workers) as pool:
        futures = []
        for number, some_cores in enumerate(shares(cores(), n_workers)):
            worker = WorkerResources(some_cores, [devices[number % len(devices)]] if devices else None)
            futures.append(pool.submit(work, partial(train, worker)))
    if request.signal_number is not None:
        raise InterruptedRunError("stopped; rerun the same command to resume", request.signal_number)
    for future in futures:
        future.result()
    return results


def _leave(number: int, _: object) -> None:
    os._exit(128 + number)  # workers die with their supervisor

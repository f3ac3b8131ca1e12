"""The local launcher: worker processes on this machine, each with own cores and CUDA devices."""

import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from parking_exp.errors import ConfigError
from parking_exp.sweeps.resources import available_cores, cuda_devices, divide_cores
from parking_exp.sweeps.supervisor import WorkerResult, supervise
from parking_exp.sweeps.worker_process import LOCAL_START_METHOD
from parking_exp.terminal import say
from parking_exp.training.signals import StopRequest, stop_on_signal

Train = Callable[[Path], WorkerResult]
"""Trains the run of a directory, and returns how it ended; `interrupted` after a signal."""


class LocalLauncher:
    """Processes of this machine, `n_jobs` at a time (None: one per core)."""

    def __init__(self, n_jobs: int | None) -> None:
        self.n_jobs = valid_n_jobs(n_jobs) or len(available_cores())

    def train(self, paths: Sequence[Path]) -> None:
        """Train runs; for errors see `run_workers`."""
        waiting = iter(paths)

        def work(train: Train) -> None:
            for path in waiting:  # shared by the workers
                try:
                    train(path)
                # E.g. its directory can't be written. The other runs continue.
                except Exception as error:
                    say(f"error: {path}: {type(error).__name__}: {error}", stderr=True)

        run_workers(work, min(self.n_jobs, len(paths)))


def valid_n_jobs(n_jobs: int | None) -> int | None:
    """Return `hydra.launcher.n_jobs`, or raise ConfigError for an invalid one."""
    if n_jobs is not None and (type(n_jobs) is not int or n_jobs <= 0):
        raise ConfigError(
            f"hydra.launcher.n_jobs={n_jobs} is not valid; give a number above 0, or null"
        )
    return n_jobs


def run_workers(work: Callable[[Train], None], n_workers: int) -> None:
    """Call `work` in a thread for each worker, with a function that trains on the worker's own
    cores and CUDA device.

    The first SIGINT or SIGTERM stops all runs, with their states saved; a second one exits at once.

    Raises:
        InterruptedRunError: a signal stopped it.
    """
    # `os._exit` leaves no worker behind, since workers die with their supervisor.
    with (
        stop_on_signal(lambda number, _: os._exit(128 + number)) as stop,
        ThreadPoolExecutor(n_workers) as pool,
    ):
        devices = itertools.cycle(cuda_devices() or [None])
        futures = []
        for own_cores in divide_cores(available_cores(), n_workers):
            train = partial(_train_on, stop, own_cores, next(devices))
            futures.append(pool.submit(work, train))
    stop.raise_if_made()
    for future in futures:
        future.result()


def _train_on(
    stop: StopRequest, own_cores: Sequence[int], device: str | None, path: Path
) -> WorkerResult:
    """Train the run of a directory on the cores and the device of one worker."""
    if stop.is_made:
        return "interrupted"
    return supervise(path, stop, own_cores, device, LOCAL_START_METHOD)

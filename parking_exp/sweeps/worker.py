"""The work of a worker process, which trains one run and dies with its supervisor."""

import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from parking_exp.errors import FailedRunError, InterruptedRunError, ParkingError, RunLockedError
from parking_exp.garbage_collection import no_garbage_collection
from parking_exp.runs.directory import RunDirectory
from parking_exp.terminal import say, unfailing_output
from parking_exp.training.signals import stop_on_signal

LOG_FILE = "log.txt"
STDOUT = 1
STDERR = 2
# Exit status if another worker, which is about to die, still holds the training lock.
LOCKED_EXIT = 75


def work(path: Path, cores: Sequence[int], environment: Mapping[str, str]) -> None:
    """Train the run of a directory, and exit with a status.

    Args:
        path: the run directory, with its config.
        cores: the cores that this process may use, with a thread each. If empty, it may use all.
        environment: environment variables, in place of those that this process has.
    """
    # A session of its own: Ctrl-C in the terminal reaches the supervisor alone, which passes it on.
    os.setsid()
    threading.Thread(target=_die_with, args=[os.getppid()], daemon=True).start()
    _redirect_output(path / LOG_FILE)
    faulthandler.enable()  # a fatal error in native code leaves a traceback in the log
    os.environ.clear()
    os.environ.update(environment)
    if cores and hasattr(os, "sched_setaffinity"):  # not on every system
        os.sched_setaffinity(0, cores)
    sys.exit(_train(RunDirectory(path), len(cores)))


def _train(directory: RunDirectory, n_threads: int) -> int:
    """Train a run, and return the exit status of its process."""
    try:
        config = directory.read_config()
        with no_garbage_collection(freeze=True):
            import torch  # reads cores and environment, which `work` has set

            from parking_exp.algorithms.torch_settings import check_device
            from parking_exp.training.train_run import train_run
        if n_threads:
            # A forked process has read the fork server's environment.
            torch.set_num_threads(n_threads)
        # Slurm signals every process of a job, and the supervisor passes on its own signal. The
        # second signal must not interrupt the checkpoint.
        with unfailing_output(), directory.training_lock(), stop_on_signal(None) as stop:
            if directory.read_result() is None:  # else another worker has finished it
                check_device(config.device)
                # The sweep writes the store.
                train_run(config, directory, stop, on_saved=lambda _: None)
    except InterruptedRunError as error:
        return 128 + error.signal_number
    except RunLockedError:
        return LOCKED_EXIT
    except ParkingError as error:
        if not isinstance(error, FailedRunError):  # which training has recorded
            directory.update_status(status="failed", error=str(error))
        say(f"error: {error}", stderr=True)
        return 2
    return 0


def _redirect_output(path: Path) -> None:
    """Append the output of this process to a file, also what native code prints."""
    with path.open("ab") as log:
        os.dup2(log.fileno(), STDOUT)
        os.dup2(log.fileno(), STDERR)


def _die_with(parent: int) -> None:
    """Kill this process when its supervisor or its parent process has ended."""
    supervisor = multiprocessing.parent_process()
    assert supervisor is not None
    while supervisor.is_alive() and os.getppid() == parent:
        time.sleep(0.5)
    os.kill(os.getpid(), signal.SIGKILL)

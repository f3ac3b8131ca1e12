"""The worker process of a sweep, which trains one run and dies with its supervisor.

Started as `python -m parking_exp.sweeps.worker RUN_DIR SUPERVISOR_PID CORES` (cores with commas, none for all).
"""

import faulthandler
import gc
import os
import signal
import sys
import threading
import time
from pathlib import Path

from parking_exp.errors import FailedRunError, InterruptedRunError, ParkingError, RunLockedError
from parking_exp.runs.directory import RunDirectory
from parking_exp.terminal import say
from parking_exp.tracking.client import import_mlflow

LOCKED_EXIT = 75  # exit status if another worker, which is about to die, still holds the training lock


def main() -> None:
    """Train the run of a directory."""
    path, supervisor, cores = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    _die_with(supervisor)
    faulthandler.enable()  # a fatal error in native code leaves a traceback in the log
    if cores and hasattr(os, "sched_setaffinity"):  # not on every system
        os.sched_setaffinity(0, map(int, cores.split(",")))
    directory = RunDirectory(path)
    try:
        config = directory.config()
        gc.disable()  # imports are 0.8 s faster without it
        from parking_exp.training.train_run import train  # of torch, for which cores and threads are settled now

        if config.tracking.mlflow:
            import_mlflow()
        gc.freeze()
        gc.enable()
        train(config, supervised=True)
    except InterruptedRunError as error:
        sys.exit(128 + error.signal_number)
    except RunLockedError:
        sys.exit(LOCKED_EXIT)
    except ParkingError as error:
        if not isinstance(error, FailedRunError):  # which training has recorded
            directory.update(status="failed", error=str(error))
        say(f"error: {error}", stderr=True)
        sys.exit(2)


def _die_with(supervisor: int) -> None:
    """Kill this process when its supervisor is gone."""

    def watch() -> None:
        while os.getppid() == supervisor:
            time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    main()

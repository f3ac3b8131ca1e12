"""A run in a process of its own, and the supervisor that starts it, waits for it and says how it ended.

Whatever launches runs, each is supervised like this: where the process dies, hangs or ends without a word, its
supervisor marks the run as failed, with the reason. Where the supervisor dies, its worker dies with it, and the run was
cut off. All results are in the run directory; nothing is returned or pickled.
"""

import ctypes
import faulthandler
import gc
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

from parking_exp.config.paths import directory_path, store_uri
from parking_exp.errors import (
    ConfigError,
    FailedRunError,
    InterruptedRunError,
    OutputDirectoryError,
    ParkingError,
    RunLockedError,
)
from parking_exp.resources import THREAD_VARIABLES, pin
from parking_exp.runs.directory import RunDirectory
from parking_exp.terminal import say
from parking_exp.tracking.store import import_mlflow

LOG_FILE = "log.txt"
GRACE_S = 8.0  # to save a checkpoint after a signal, before the process is killed
PARENT_POLL_S = 0.5
POLL_S = 0.05
PR_SET_PDEATHSIG = 1
LOCKED = 75  # exit status of a worker that found another one at its run, one that takes long to die
# Signals that come from outside, and say nothing about the run; the others are its own crashes.
KILLS = {signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP}

Ending = Literal["done", "failed", "stopped", "elsewhere"]
OnStart = Callable[[subprocess.Popen[bytes]], None]


@dataclass(frozen=True)
class Share:
    """What a worker may use: cores to stay on (none: all), threads of BLAS and torch, CUDA devices (None: all)."""

    cores: Sequence[int] = ()
    devices: Sequence[str] | None = None

    def environment(self) -> dict[str, str]:
        """Return the environment variables that say so."""
        found = dict.fromkeys(THREAD_VARIABLES, str(len(self.cores))) if self.cores else {}
        if self.devices is not None:
            found["CUDA_VISIBLE_DEVICES"] = ",".join(self.devices)
        return found


def supervise(
    path: Path, share: Share | None = None, stop: threading.Event | None = None, started: OnStart | None = None
) -> Ending:
    """Train one run in a fresh process, and see to it that its directory says how that went.

    Args:
        path: the run directory, with its frozen config.
        share: of the machine; None: all of it.
        stop: once set, the run saves a checkpoint and leaves; after GRACE_S it is killed.
        started: called with the process.

    Returns:
        done; failed, with the reason in status.json; stopped, because it was asked to; elsewhere: another process has
        claimed the run.
    """
    directory = RunDirectory(path)
    if directory.under_way:
        return "elsewhere"
    try:
        with directory.claimed():
            if (status := directory.status) == "done" and directory.can_make_models:
                _make_models(directory)
            if status in ("done", "failed"):
                return status  # by another sweep, since this one was planned
            return _run(directory, share or Share(), stop or threading.Event(), started)
    except RunLockedError:
        return "elsewhere"


def _make_models(directory: RunDirectory) -> None:
    """Make models that are gone again. That is a copy, and takes no process of its own; the run stays done."""
    from parking_exp.training.recovery import make_models

    try:
        say(make_models(directory), stderr=True)
    except ParkingError as error:
        say(f"error: {error}", stderr=True)
    except OSError as error:
        say(f"error: {directory.models} cannot be written: {error.strerror}", stderr=True)


def _run(directory: RunDirectory, share: Share, stop: threading.Event, started: OnStart | None) -> Ending:
    try:
        config = directory.config()
        if config.run_dir != directory_path(directory.path):
            raise ConfigError(f"{directory.path / 'config.yaml'} is the config of another run; type the sweep again")
        directory.reserve()
    except (ConfigError, OutputDirectoryError) as error:
        directory.update(status="failed", error=str(error))
        return "failed"
    # Before there is a worker: what that one writes is later, and must not be overwritten.
    started_at = {"host": socket.gethostname(), "started": time.time()}
    # With the store, so that it hears of a run that fails before it tracks anything.
    uri = store_uri(config) if config.tracking.mlflow else None
    directory.update(status="running", error=None, killed=None, tracking_uri=uri, **started_at)
    with (directory.path / LOG_FILE).open("ab") as log:
        process = _start(directory.path, share, log)
        try:
            directory.update(pid=process.pid)
            if started is not None:
                started(process)
            late = _wait(process, config.timeout_s, stop)
        finally:
            if process.poll() is None:  # something went wrong here: nobody is left without a supervisor
                _kill(process)
    past = f"ran past timeout_s={config.timeout_s:g}" if late else None
    return _ending(directory, process.returncode, past, stop.is_set())


def _wait(process: subprocess.Popen[bytes], timeout_s: float | None, stop: threading.Event) -> bool:
    """Wait for a worker, and end it if it is asked to stop or takes too long; return whether it took too long."""
    begin, asked, late = time.monotonic(), None, False
    while process.poll() is None:
        time.sleep(POLL_S)
        late = late or (timeout_s is not None and time.monotonic() - begin > timeout_s)
        if asked is None and (late or stop.is_set()):
            asked = time.monotonic()
            process.terminate()
        if asked is not None and time.monotonic() - asked > GRACE_S:
            _kill(process)
    return late


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a worker with everything that it has started, and wait for its end."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)  # it leads a session of its own
    process.wait()


def _ending(directory: RunDirectory, code: int, late: str | None, stopped: bool) -> Ending:
    """Say how a worker ended, from its exit status and what it wrote."""
    status = directory.status
    if status == "done":
        return "done"
    if code == LOCKED:
        return "elsewhere"
    if late is None and status == "failed":
        return "failed"
    if late is None and (stopped or status == "interrupted"):
        directory.update(status="interrupted")
        return "stopped"
    if late is not None:
        reason = late
    elif code < 0:
        reason = f"killed by {_signal_name(-code)}{' (out of memory?)' if -code == signal.SIGKILL else ''}"
    else:
        reason = f"its process ended with status {code} and without a result; see {directory.path / LOG_FILE}"
    directory.update(status="failed", error=reason, killed=(late is None and -code in KILLS) or None)
    return "failed"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a real-time signal
        return f"signal {number}"


def _start(path: Path, share: Share, log: IO[bytes]) -> subprocess.Popen[bytes]:
    root = str(Path(__file__).resolve().parents[2])
    paths = [root, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    environment = {**os.environ, **share.environment(), "PYTHONPATH": os.pathsep.join(paths)}
    cores = ",".join(map(str, share.cores))
    command = [sys.executable, "-m", "parking_exp.sweeps.worker", str(path), str(os.getpid()), cores]
    # A session of its own: Ctrl-C in the terminal reaches the supervisor alone, who passes it on in good order.
    return subprocess.Popen(
        command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
    )


def work(path: str) -> Ending:
    """Supervise one run as a job of somebody else's launcher.

    Raises:
        KeyboardInterrupt: a signal to the job stopped it; the run's state is saved.
    """
    stop = threading.Event()
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for signal_number in (signal.SIGTERM, signal.SIGINT, signal.SIGUSR2):  # the last is submitit's: time is short
            before[signal_number] = signal.signal(signal_number, lambda *_: stop.set())
    try:
        ending = supervise(Path(path), stop=stop)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if stop.is_set():  # not an Exception: a launcher that goes through its jobs one by one is to stop, too
        raise KeyboardInterrupt
    return ending


def main() -> None:
    """Train the run of a directory: `python -m parking_exp.worker RUN_DIR SUPERVISOR_PID CORES`."""
    path, supervisor, cores = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    _die_with(supervisor)
    faulthandler.enable()  # a crash in native code leaves a traceback in the log
    if cores:
        pin([int(core) for core in cores.split(",")])
    directory = RunDirectory(path)
    try:
        config = directory.config()
        gc.disable()  # importing without it takes .8 s less
        from parking_exp.training.run import train  # of torch, for which cores and threads are settled now

        if config.tracking.mlflow:
            import_mlflow()
        gc.freeze()
        gc.enable()
        train(config, supervised=True)
    except InterruptedRunError as error:
        sys.exit(128 + error.signal_number)
    except RunLockedError:
        sys.exit(LOCKED)
    except FailedRunError as error:
        say(f"error: {error}", stderr=True)
        sys.exit(2)
    except ParkingError as error:
        directory.update(status="failed", error=str(error))
        say(f"error: {error}", stderr=True)
        sys.exit(2)


def _die_with(supervisor: int) -> None:
    """Have this process killed when its supervisor is gone, whatever it is doing then."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)

    def watch() -> None:
        while os.getppid() == supervisor:
            time.sleep(PARENT_POLL_S)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    main()

"""Errors that the command line prints as a sentence, without a traceback."""

import errno
import sqlite3
from collections.abc import Iterator, Mapping
from typing import Any

# Problems of disks and permissions. Any other `OSError` may be a bug, and keeps its traceback.
DISK_ERRORS = {
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO,
    errno.EROFS, errno.EACCES, errno.EPERM, errno.EEXIST,
    errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP, errno.ESTALE, errno.ENOLCK,
}  # fmt: skip
MAX_REASON_LENGTH = 200


class ParkingError(Exception):
    """Base class of errors caused by user input or by the machine, printed without a traceback."""


class ConfigError(ParkingError, ValueError):
    """A config that can't run; each line is a sentence: the key, what is wrong, what to type."""


class RunNotFoundError(ParkingError, LookupError):
    """There is no such run, or none that is finished."""


class UntrustedError(ParkingError):
    """Foreign data that would execute code, or read and write files elsewhere."""


class ModelError(ParkingError):
    """A file of a model, a replay buffer or demonstrations that is damaged or does not fit, or a
    model that can't do what is asked.
    """


class OutputDirectoryError(ParkingError):
    """A file or folder that can't be made, read or written."""


class RunLockedError(ParkingError):
    """Another process is working on the same run."""


class ResultsError(ParkingError, LookupError):
    """Results that do not exist, or that can't be read."""


class StoreError(ParkingError):
    """A store or study that can't be used, rejects a run, or lacks runs."""


class VideoError(ParkingError):
    """There is no video or replay: the task has none, or this machine can't render."""


class EnvProcessError(ParkingError):
    """A process of an env (`env.vectorization=async`) has ended."""


class DivergenceError(ParkingError):
    """An observation, a reward or a loss that is not finite."""


class CrossCheckError(ParkingError):
    """Two simulators of a task, e.g. ours and highway-env, disagree on an episode."""


class InterruptedRunError(ParkingError):
    """A run was stopped by a signal, e.g. `signal.SIGINT`, after its state was saved."""

    def __init__(self, message: str, signal_number: int) -> None:
        super().__init__(message)
        self.signal_number = signal_number


class FailedRunError(ParkingError):
    """A run that failed. The cause is its `__cause__`; the traceback is in the run directory."""


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message, or the name of its class where it has none."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def one_line(error: object) -> str:
    """Return an error's message as one line."""
    return " ".join(str(error).split())


def class_and_message(error: BaseException) -> str:
    """Return an error's class and message as one line."""
    return f"{type(error).__name__}: {one_line(error)}"


def reason_of_invalid_value(problem: Mapping[str, Any]) -> str:
    """Return why a value is invalid, to end a sentence with.

    `problem` is an item of pydantic's `ValidationError.errors()`.
    """
    message = problem["msg"].removeprefix("Value error, ")
    return message[0].lower() + message[1:]


def reason_of_store_failure(error: BaseException) -> str:
    """Return in one line why a store failed, in the words of the system or sqlite if possible."""
    reported = error
    if not isinstance(error, ParkingError):
        for cause in _causes(error):
            if isinstance(cause, OSError | sqlite3.Error):
                reported = cause
    return (one_line(reported) or type(reported).__name__)[:MAX_REASON_LENGTH]


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield an error, its cause, the cause of that, and so on."""
    seen = []
    cause: BaseException | None = error
    while cause is not None and cause not in seen:
        seen.append(cause)
        yield cause
        cause = cause.__cause__ or cause.__context__

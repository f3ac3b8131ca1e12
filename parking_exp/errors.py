"""Errors that a user can meet, and phrases that their messages share.

A message is a sentence, and the command line prints it without a traceback.
"""

import difflib
import errno
from collections.abc import Iterable

# What the system says of a disk and of rights on it. Any other `OSError` may be a bug, and keeps its traceback.
DISK_ERRORS = {
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM, errno.EEXIST,
    errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ELOOP, errno.ESTALE, errno.ENOLCK,
}  # fmt: skip


class ParkingError(Exception):
    """Base class of errors caused by user input or by the machine, printed without a traceback."""


class ConfigError(ParkingError, ValueError):
    """A config that cannot run. Each line is one sentence: which key, what is wrong, what to type instead."""


class RunNotFoundError(ParkingError, LookupError):
    """No run matches the given name."""


class UntrustedError(ParkingError):
    """A stored config would execute something that may come from anywhere."""


class ModelError(ParkingError):
    """A model file that is not of the model it is loaded into, or a class whose files do not hold all weights."""


class DamagedModelError(ModelError):
    """A model file that can't be read, or holds something else than weights."""


class OutputDirectoryError(ParkingError):
    """A run directory cannot be made."""


class RunLockedError(ParkingError):
    """Another process is working on the same run."""


class ResultsError(ParkingError, LookupError):
    """Results of runs that are not where they were looked for, or that can't be read."""


class DamagedFileError(ParkingError):
    """A file of a run directory is corrupt."""


class StoreError(ParkingError):
    """A store that can't take a run as it is, or has not got all that the run directories have."""


class CertificationError(ParkingError):
    """The simulator that evaluated a run and highway-env itself do not agree."""


class InterruptedRunError(ParkingError):
    """A run was stopped by a signal, after its state was saved.

    Attributes:
        signal_number: the signal, e.g. `signal.SIGINT`.
    """

    def __init__(self, message: str, signal_number: int) -> None:
        super().__init__(message)
        self.signal_number = signal_number


class FailedRunError(ParkingError):
    """A run that broke. The cause is its `__cause__`, and its traceback is in the run directory."""


def plural(number: int, noun: str) -> str:
    """Return `1 run`, `2 runs`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def quoted_label(label: str) -> str:
    """Return a label as it stands in a sentence: in quotes if it has commas, so that it reads as one name."""
    return f"“{label}”" if "," in label or ";" in label else label


def did_you_mean(word: str, choices: Iterable[str], cutoff: float = 0.5) -> str:
    """Return `; did you mean 'x'?` for the closest choice, or nothing when none is close."""
    match = difflib.get_close_matches(word, sorted(set(choices)), n=1, cutoff=cutoff)
    return f"; did you mean {match[0]!r}?" if match else ""


def suggestion(word: str, choices: Iterable[str]) -> str:
    """Return `; did you mean 'x'?`, or the choices when none is close and they are few, or nothing."""
    names = sorted(set(choices))
    if match := did_you_mean(word, names):
        return match
    if names and len(names) <= 30:
        return "; choose from " + ", ".join(names)
    return ""

"""Errors that a user can meet. Their message is a sentence, and the command line prints it without a traceback."""


class ParkingError(Exception):
    """Base of all errors that are the user's to mend."""


class ConfigError(ParkingError, ValueError):
    """A config that cannot run. Each line is one sentence: which key, what is wrong, what to type instead."""


class RunNotFoundError(ParkingError, LookupError):
    """No run answers to a name."""


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
    """A file of a run directory that has lost something, or is not what it has to be."""


class StoreError(ParkingError):
    """A store that is up and can't take a run as it is."""


class UnsyncedError(ParkingError):
    """A store fails, and has not got all that the run directories have."""


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

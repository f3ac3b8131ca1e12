"""Turn SIGINT, SIGTERM and SIGHUP into a stop request, which long activities check for."""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

from parking_exp.errors import InterruptedRunError


@dataclass
class StopRequest:
    """A request to stop: the number of the signal that made it, or None so far."""

    signal_number: int | None = None

    @property
    def is_made(self) -> bool:
        """Whether a signal has arrived."""
        return self.signal_number is not None

    def raise_if_made(self, where: str = "") -> None:
        """Raise InterruptedRunError if a signal has arrived; `where` is for its message."""
        if self.signal_number is not None:
            raise InterruptedRunError(
                f"stopped{where}; rerun the same command to resume", self.signal_number
            )


@contextmanager
def stop_on_signal(
    at_second: Callable[[int, FrameType | None], object] | None = signal.default_int_handler,
    signals: Sequence[int] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP),
) -> Iterator[StopRequest]:
    """Turn the first of some signals into a StopRequest.

    `at_second` handles later signals; None ignores them.

    When a terminal is closed, the shell and the system both send SIGHUP, so it never counts as a
    second signal. Under `nohup` it stays ignored. Outside the main thread signals can't be caught,
    and this does nothing.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if not request.is_made:
            request.signal_number = number
            hint = b"; interrupt again to leave at once" if at_second else b""
            with suppress(OSError):  # the terminal may be gone
                # Not print: the signal may have interrupted one.
                os.write(2, b"\nstopping after a checkpoint" + hint + b"\n")
        elif at_second and number != signal.SIGHUP:
            at_second(number, frame)

    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signals = [number for number in signals if number != signal.SIGHUP]
    before = {number: signal.signal(number, handle) for number in signals}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

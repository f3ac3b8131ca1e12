"""Turn SIGINT and SIGTERM into a stop request that is honoured between rollouts."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType


@dataclass
class StopRequest:
    """A request to stop: the number of the signal that made it, or None so far."""

    signal_number: int | None = None


def interrupt(number: int) -> None:
    """Raise KeyboardInterrupt."""
    raise KeyboardInterrupt


@contextmanager
def stop_on_signal(
    at_first: Callable[[], None] = lambda: None, at_second: Callable[[int], None] = interrupt
) -> Iterator[StopRequest]:
    """Turn the first SIGINT or SIGTERM into a StopRequest; a second one interrupts at once.

    Outside the main thread signals can't be caught, and nothing changes.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def handle(number: int, _: FrameType | None) -> None:
        if request.signal_number is not None:
            at_second(number)
            return
        request.signal_number = number
        at_first()
        # Not print: the signal may have come in the middle of one.
        os.write(2, b"\nsaving a checkpoint before leaving; interrupt again to leave at once\n")

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

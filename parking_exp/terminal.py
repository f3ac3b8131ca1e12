"""Print on a terminal that may go away; escape control characters of text that may be hostile."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO, cast

from rich.console import Console
from rich.text import Text

COMMANDS = {"train", "tune", "status", "report", "evaluate", "export"}
WIDE = 1000  # columns of a file or pipe, where lines are not wrapped


def escape_unprintable(line: str) -> str:
    r"""Escape what can't be printed or encoded in a line, e.g. as `\x1b`, `\n` or `\u202e`."""
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return line.encode(encoding, "backslashreplace").decode(encoding)


def say(*lines: str, stderr: bool = False) -> None:
    """Print lines; a line break within one is shown as `\\n`."""
    print(*map(escape_unprintable, lines), sep="\n", file=sys.stderr if stderr else sys.stdout)


class _UnfailingStream:
    """A standard stream that drops what can't be written: its terminal is gone, its pipe closed,
    its disk full.
    """

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream or open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        """Write a text, or drop it."""
        try:
            self._stream.write(text)
        except OSError as error:
            self.error = error
        except ValueError:  # the stream is closed, or has no such characters
            pass
        return len(text)

    def flush(self) -> None:
        """Flush the stream, as far as possible."""
        try:
            self._stream.flush()
        except OSError as error:
            self.error = error
        except ValueError:  # it is closed
            pass

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def unfailing_output() -> Iterator[None]:
    """Ignore failed writes to the standard streams in a block: they must not end a run."""
    streams = sys.stdout, sys.stderr
    make_output_unfailing()
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams


def make_output_unfailing() -> None:
    """Let no write to the standard streams of this process fail."""
    sys.stdout = cast(TextIO, _UnfailingStream(sys.stdout))
    sys.stderr = cast(TextIO, _UnfailingStream(sys.stderr))


def check_output() -> None:
    """Raise the OSError of a standard output that was lost.

    Only commands that do nothing but print call this.
    """
    sys.stdout.flush()
    error = getattr(sys.stdout, "error", None)
    if error is not None:
        raise error


def open_standard_streams() -> None:
    """Open standard streams that are closed.

    Otherwise the next file would get the descriptor of one, and then its output.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free descriptor, which is this one
            os.set_inheritable(descriptor, True)


def drop_unwritten_output() -> None:
    """Drop what the standard streams couldn't write: Python would retry at its exit, and fail."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class Screen(Console):
    """A console without markup: brackets and colons are printed as they are."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"highlight": False, "markup": False, "emoji": False, **options})

    def render_str(self, text: str, **options: Any) -> Text:
        """Escape a string; rich calls this for every line and table cell."""
        return super().render_str(escape_unprintable(text), **options)


def make_console(*, stderr: bool = False) -> Console:
    """Return a console that does not wrap lines."""
    out = Screen(stderr=stderr, soft_wrap=True)
    return out if out.is_terminal else Screen(stderr=stderr, width=WIDE)


def is_script() -> bool:
    """Return whether this process is our script in a clone, not a command or a user's Python."""
    program = Path(sys.argv[0]).absolute()
    is_in_scripts = program.parent.name == "scripts"  # elsewhere, train.py is a user's program
    return is_in_scripts and program.suffix == ".py" and program.stem in COMMANDS


def command_of(name: str) -> str:
    """Return how to start a command, as this process was: `python scripts/status.py`, or
    `parking-status`.
    """
    return f"python scripts/{name}.py" if is_script() else f"parking-{name}"

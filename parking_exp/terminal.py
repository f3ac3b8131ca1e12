"""Text on a terminal.

What is read from a run directory or a store may be anyone's. Characters that would do something to the terminal (escape
sequences, line breaks, directions of writing) are shown as Python would write them, and not sent.
"""

import logging
import sys
from typing import Any

from rich.console import Console
from rich.text import Text

WIDE = 1000  # columns of what is no terminal: lines are not broken there


def printable(line: str) -> str:
    r"""Return a line with escapes such as `\x1b`, `\n`, `\u202e` for what is not printable or can't be encoded."""
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    encoding = sys.stdout.encoding or "utf-8"
    return line.encode(encoding, "backslashreplace").decode(encoding)


def say(*lines: str, stderr: bool = False) -> None:
    """Print lines; a line break within one is shown as `\\n`."""
    print(*map(printable, lines), sep="\n", file=sys.stderr if stderr else sys.stdout)


class Screen(Console):
    """A console that prints names and reasons as they are: brackets and colons in them mean nothing."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"highlight": False, "markup": False, "emoji": False, **options})

    def render_str(self, text: str, **options: Any) -> Text:
        """Convert a string, be it a line or a cell of a table, as rich does for all that it prints."""
        return super().render_str(printable(text), **options)


def console(*, stderr: bool = False) -> Console:
    """Return a console that breaks no lines."""
    out = Screen(stderr=stderr, soft_wrap=True)
    return out if out.is_terminal else Screen(stderr=stderr, width=WIDE)


class LogFormatter(logging.Formatter):
    """Formats log records for a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record's lines, its traceback included."""
        return "\n".join(map(printable, super().format(record).split("\n")))

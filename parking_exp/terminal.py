"""Print text on a terminal, with control characters escaped: text from a run directory or store may be hostile."""

import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

COMMANDS = {"train", "tune", "status", "report", "evaluate", "export"}
WIDE = 1000  # columns of a file or pipe, where lines are not wrapped


def printable(line: str) -> str:
    r"""Return a line with unprintable or unencodable characters escaped, e.g. `\x1b`, `\n`, `\u202e`."""
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    encoding = sys.stdout.encoding or "utf-8"
    return line.encode(encoding, "backslashreplace").decode(encoding)


def say(*lines: str, stderr: bool = False) -> None:
    """Print lines; a line break within one is shown as `\\n`."""
    print(*map(printable, lines), sep="\n", file=sys.stderr if stderr else sys.stdout)


class Screen(Console):
    """A console without markup: brackets and colons are printed as they are."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"highlight": False, "markup": False, "emoji": False, **options})

    def render_str(self, text: str, **options: Any) -> Text:
        """Escape a string; rich calls this for every line and table cell."""
        return super().render_str(printable(text), **options)


def console(*, stderr: bool = False) -> Console:
    """Return a console that does not wrap lines."""
    out = Screen(stderr=stderr, soft_wrap=True)
    return out if out.is_terminal else Screen(stderr=stderr, width=WIDE)


def is_script() -> bool:
    """Return whether this process is one of our scripts in a clone, and not an installed command or a user's Python."""
    program = Path(sys.argv[0])
    return program.suffix == ".py" and program.stem in COMMANDS


def program(name: str) -> str:
    """Return how to start a command, as this process was: `python scripts/status.py`, or `parking-status`."""
    return f"python scripts/{name}.py" if is_script() else f"parking-{name}"

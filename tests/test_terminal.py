"""Tests of printing untrusted text to a terminal: control characters are escaped."""

import io

import pytest
from rich.table import Table

from parking_exp.terminal import Screen, command_of, escape_unprintable, say

HOSTILE = "a\x1b]0;t\x07\x1b[2J\x9b31m\r\b\x7f\u202eb\u2066\nfailed   c\x00\t\u2028\udc9b"
SHOWN = r"a\x1b]0;t\x07\x1b[2J\x9b31m\r\x08\x7f\u202eb\u2066\nfailed   c\x00\t\u2028\udc9b"


def test_characters_that_are_not_printable_are_shown_as_escapes():
    assert escape_unprintable(HOSTILE) == SHOWN
    assert escape_unprintable("größe 学習 λ − “a, b” é") == "größe 学習 λ − “a, b” é"  # noqa: RUF001


def test_characters_that_the_output_can_not_encode_are_shown_as_escapes(monkeypatch):
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", out)
    say("“a” − é")  # noqa: RUF001
    Screen(file=out, width=300).print("“a”")
    out.flush()
    assert out.buffer.getvalue() == rb"\u201ca\u201d \u2212 \xe9" b"\n" rb"\u201ca\u201d" b"\n"


def test_a_console_shows_lines_cells_and_headings():
    out = io.StringIO()
    screen = Screen(file=out, force_terminal=True, color_system=None, width=300)
    table = Table(box=None)
    table.add_column(f"1{HOSTILE}")
    table.add_row(f"2{HOSTILE}")
    screen.print(table)
    screen.print(f"3{HOSTILE}")
    screen.print(f"[bold] :warning: {HOSTILE}")
    lines = [line.strip() for line in out.getvalue().splitlines()]
    assert lines == [f"1{SHOWN}", f"2{SHOWN}", f"3{SHOWN}", f"[bold] :warning: {SHOWN}"]


@pytest.mark.parametrize(
    ("started", "named"),
    [
        ("scripts/train.py", "python scripts/status.py"),
        ("/somewhere/scripts/report.py", "python scripts/status.py"),
        ("/somewhere/bin/parking-train", "parking-status"),
        ("my_study.py", "parking-status"),
        ("/somewhere/my_programs/train.py", "parking-status"),
        ("/somewhere/ipykernel_launcher.py", "parking-status"),
        ("", "parking-status"),
    ],
)
def test_messages_name_commands_as_this_process_was_started(started, named, monkeypatch):
    monkeypatch.setattr("sys.argv", [started])
    assert command_of("status") == named

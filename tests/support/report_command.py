"""`scripts/report.py` in this process: a process of its own would import for seconds."""

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from typing import NamedTuple

import pytest

from parking_exp.cli.report import main


class Done(NamedTuple):
    stdout: str
    stderr: str


def report(output_dir, *arguments, code=0):
    """Run the command in an output directory, and return what it printed."""
    out, err, status = io.StringIO(), io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(output_dir)
        patch.setattr(sys, "argv", ["report.py", *arguments, f"output_dir={output_dir}"])
        try:
            main()
        except SystemExit as end:
            status = end.code
    assert status == code, err.getvalue()
    return Done(out.getvalue(), err.getvalue())

"""A terminal that goes away, a closed pipe, a full disk under a log: output is lost, and nothing
else.
"""

import json
import os
import signal
import subprocess
import sys

import pytest
from support.marks import slow_but
from support.runs import only_run, script
from support.sweep_processes import QUICK, SLOW, begin, stages, wait_until

from parking_exp.config.compose import compose
from parking_exp.sweeps.single_run import train
from parking_exp.training.signals import stop_on_signal

CLOSED = ">&- 2>&- <&-"
FULL = ">/dev/full 2>&1"
ONE_LINE = "2>&1 | head -1"


def shell(name, *arguments, redirected, cwd=None):
    """Run a script with its output redirected by a shell; return its exit status, output and
    errors.
    """
    command, keywords = script(name, *arguments, cwd=cwd)
    line = f'"$@" {redirected}; exit ${{PIPESTATUS[0]}}'
    whole = ["bash", "-c", line, "bash", *command]
    return subprocess.run(whole, check=False, capture_output=True, timeout=300, **keywords)


@pytest.fixture
def output_dir(tmp_path):
    """An output directory with a run that is done."""
    path = tmp_path / "smoke" / "cell" / "seed=0"
    path.mkdir(parents=True)
    (path / "status.json").write_text(json.dumps({"status": "done", "label": "a"}))
    return tmp_path


@pytest.mark.parametrize("redirected", slow_but([CLOSED], [CLOSED, FULL, ONE_LINE]))
@pytest.mark.parametrize("seeds", slow_but(["seed=0"], ["seed=0", "seeds=2"]))
def test_a_training_whose_output_is_lost_is_done(tmp_path, redirected, seeds):
    arguments = (*QUICK, seeds, "tracking.stdout=true", f"output_dir={tmp_path}")
    done = shell("train", *arguments, redirected=redirected)
    assert done.returncode == 0
    assert set(stages(tmp_path)) == {"done"}
    config = next(tmp_path.glob("*/*/*/config.yaml")).read_text()
    assert "env steps" not in config  # no file got the descriptor of a closed stream


def test_a_training_goes_on_after_its_terminal_is_gone(tmp_path):
    master, terminal = os.openpty()
    command, keywords = script("train", *QUICK, f"output_dir={tmp_path}")
    process = subprocess.Popen(
        command, stdin=terminal, stdout=terminal, stderr=terminal, **keywords
    )
    os.close(terminal)
    os.read(master, 1)
    os.close(master)  # writes fail with EIO from now on
    assert process.wait(120) == 0
    assert only_run(tmp_path).status == "done"


class BrokenPipe:
    """A stream whose reader is gone."""

    encoding = "utf-8"

    def write(self, text):
        raise BrokenPipeError

    def flush(self):
        raise BrokenPipeError


def test_a_training_that_python_calls_survives_lost_output(tmp_path, monkeypatch):
    config = compose(*QUICK, "tracking.stdout=true", f"output_dir={tmp_path}")
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, BrokenPipe())
    assert train(config).steps == 60
    assert isinstance(sys.stdout, BrokenPipe)


@pytest.mark.parametrize("name", ["status", "evaluate", "export", "report", "tune"])
def test_help_survives_closed_streams(name, tmp_path):
    assert shell(name, "--help", redirected=CLOSED, cwd=tmp_path).returncode == 0


def test_commands_that_only_print_say_that_their_output_is_lost(output_dir):
    lost = shell("status", "json=true", f"output_dir={output_dir}", redirected=">/dev/full")
    assert (lost.returncode, lost.stderr) == (2, "error: No space left on device\n")
    closed = shell("status", f"output_dir={output_dir}", redirected=CLOSED)
    assert (closed.returncode, closed.stdout, closed.stderr) == (0, "", "")


def test_watching_ends_when_nobody_reads_any_more(output_dir):
    done = shell("status", "watch=true", f"output_dir={output_dir}", redirected="| head -1")
    assert (done.returncode, done.stderr) == (1, "")
    assert done.stdout.startswith("cell ")


def test_a_closed_terminal_is_a_request_to_stop_and_a_second_signal_of_it_is_ignored():
    with stop_on_signal() as request:
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
    assert request.signal_number == signal.SIGHUP


def test_under_nohup_a_closed_terminal_stops_nothing():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_on_signal() as request:
            signal.raise_signal(signal.SIGHUP)
        assert not request.is_made
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.slow
def test_a_sweep_whose_terminal_is_closed_saves_its_runs(tmp_path):
    process = begin(tmp_path, "seeds=2", *SLOW)
    wait_until(lambda: len([*tmp_path.glob("*/*/*/checkpoints/step=*")]) >= 2)
    process.stdout.close()
    process.stderr.close()
    os.killpg(process.pid, signal.SIGHUP)
    assert process.wait(60) == 128 + signal.SIGHUP
    assert stages(tmp_path) == ["interrupted", "interrupted"]

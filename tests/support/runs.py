"""Compose configs, run scripts in processes or here, and read what their runs left."""

import contextlib
import functools
import gzip
import importlib.util
import io
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from parking_exp.cli.evaluate import evaluate
from parking_exp.config.compose import compose
from parking_exp.config.settings import flatten_config
from parking_exp.errors import ConfigError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import METRICS_FILE, read_metrics

ROOT = Path(__file__).resolve().parents[2]
GROUPS = (
    "env",
    "algorithm",
    "buffer",
    "budget",
    "envs",
    "evaluation",
    "checkpoint",
    "tracking",
    "experiment",
)


def options(group):
    """Names of a config group's options."""
    return sorted(path.stem for path in (ROOT / "conf" / group).glob("*.yaml"))


def parking_envs():
    """Names of the options of `env` that are parking-v0 or a variant of it."""
    return [option for option in options("env") if option.startswith("parking")]


@functools.cache
def smoke_config(*overrides):
    """Compose a cell of the smoke experiment, once."""
    return compose("experiment=smoke", *overrides)


def import_script(name):
    """The module `scripts/NAME.py`."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, name, module)  # where its dataclasses look for themselves
        spec.loader.exec_module(module)
    return module


def script(name, *arguments, cwd=None, env=None):
    """Command and options of `python scripts/NAME.py ...` as a process of its own."""
    command = [sys.executable, str(ROOT / "scripts" / f"{name}.py"), *arguments]
    return command, {"cwd": cwd, "env": {**os.environ, **(env or {})}, "text": True}


def run_script(name, *arguments, cwd=None, env=None, timeout=180, code=None):
    """Run a script to its end, which has the exit status `code`, if that is given."""
    command, keywords = script(name, *arguments, cwd=cwd, env=env)
    done = subprocess.run(command, check=False, capture_output=True, timeout=timeout, **keywords)
    assert code in (None, done.returncode), done
    return done


def run_code(code, *arguments, cwd=None):
    """Run a program in a process of its own, which succeeds."""
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=180, cwd=cwd
    )
    assert done.returncode == 0, done.stderr
    return done


def call_script(name, *arguments, cwd=None, code=None):
    """Do in this process what `python scripts/NAME.py ...` does: for what says or writes the same
    in any process. It has the exit status `code`, if that is given.
    """
    main = importlib.import_module(f"parking_exp.cli.{name}").main
    output = io.StringIO()
    errors = io.StringIO()
    status = 0
    with contextlib.ExitStack() as stack:
        stack.enter_context(pytest.MonkeyPatch.context()).setattr(
            sys, "argv", [f"scripts/{name}.py", *arguments]
        )
        stack.enter_context(contextlib.chdir(cwd or Path.cwd()))
        stack.enter_context(contextlib.redirect_stdout(output))
        stack.enter_context(contextlib.redirect_stderr(errors))
        try:
            main()
        except SystemExit as left:
            status = left.code or 0
    done = subprocess.CompletedProcess(
        [name, *arguments], status, output.getvalue(), errors.getvalue()
    )
    assert code in (None, done.returncode), done
    return done


def refusal(name, *arguments, cwd=None):
    """The sentence with which a script refuses what was typed, without "error: ". Besides, it may
    only have said which run it looked at.
    """
    done = call_script(name, *arguments, cwd=cwd, code=2)
    assert all(line.startswith(("run=", "run directory")) for line in done.stdout.splitlines())
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    return line.removeprefix("error: ")


def config_refusal(*overrides):
    """The sentence with which the config of a run is refused."""
    with pytest.raises(ConfigError) as refused:
        compose(*overrides)
    sentence = str(refused.value)
    assert "\n" not in sentence
    return sentence


def evaluate_stored(path, *arguments):
    """Evaluate a run directory as `scripts/evaluate.py` does, on one episode, with the errors as
    they are.
    """
    lines = [f"run='{path}'", "episodes=1", "simulator=vectorized", *arguments]
    return evaluate(lines, None)


def sync_stored(output_dir, *arguments, code=0):
    """Send what the store of an output directory lacks, as `scripts/status.py` does."""
    return call_script("status", f"output_dir={output_dir}", "sync=true", *arguments, code=code)


def in_memory():
    """A temporary directory that does not wait for a disk, where there is such a place: a sqlite
    store does, often.
    """
    place = Path("/dev/shm")
    return tempfile.TemporaryDirectory(dir=place if os.access(place, os.W_OK) else None)


@contextlib.contextmanager
def copy_of(empty):
    """A temporary output directory with a copy of the store of the fixture `empty`."""
    with in_memory() as folder:
        shutil.copy(empty / "mlflow.db", folder)
        yield Path(folder)


def only_run(output_dir):
    """The one run directory under an output directory."""
    (path,) = output_dir.glob("*/*/seed=*")
    return RunDirectory(path)


def store(output_dir):
    """A client of an output directory's own store."""
    from parking_exp.config.paths import default_uri
    from parking_exp.tracking.client import connect

    return connect(default_uri(output_dir))


def artifacts(client, run_id, folder=None):
    """All artifact paths of a run."""
    paths = []
    for item in client.list_artifacts(run_id, folder):
        paths += artifacts(client, run_id, item.path) if item.is_dir else [item.path]
    return sorted(paths)


def stored_params(config):
    """A run's config as the parameters that MLflow has of it."""
    return {key: str(value) for key, value in flatten_config(config.plain()).items()}


def history(client, run_id, key):
    return [(point.step, point.value) for point in client.get_metric_history(run_id, key)]


CLOCKED = {"time/fps", "time/time_elapsed", "time/cpu_s", "time/wall_s"}
"""Metrics that a clock says: the only ones in which a run that was cut off may differ from one that
was not.
"""


def assert_store_is_whole(output_dir, total_timesteps):
    """The run is finished in the store, has every step once, and the values of the run
    directory.
    """
    directory = only_run(output_dir)
    client = store(output_dir)
    run = client.get_run(directory.run_id)
    assert run.info.status == "FINISHED"
    assert run.data.tags["status"] == "done"
    local = {}
    for record in read_metrics(directory.path / METRICS_FILE):
        for key, value in record["metrics"].items():
            local.setdefault(key, []).append((record["step"], value))
    assert set(run.data.metrics) == set(local)
    for key, points in local.items():
        steps = [step for step, _ in points]
        assert steps == sorted(set(steps)), key
        assert history(client, directory.run_id, key) == points, key
    assert history(client, directory.run_id, "final/success_rate")[-1][0] == total_timesteps


def names_in(folder):
    """Names of the entries of a folder, sorted."""
    return sorted(path.name for path in folder.iterdir())


def read_text(path):
    """Content of a file of an export, unpacked."""
    content = path.read_bytes()
    return (gzip.decompress(content) if path.suffix == ".gz" else content).decode()

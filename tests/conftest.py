"""Fixtures of all tests: output directories with a store, and a finished run."""

import gc
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from filelock import FileLock
from support.runs import ROOT, copy_of, in_memory, only_run, run_script

CHROMIUM_ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-sync",
]

torch.set_num_threads(1)  # networks this small gain nothing from more, and other processes do


def pytest_collection_finish():
    """What has been imported stays: to look through it for garbage again and again is a tenth of
    the time of a test.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def state_home(tmp_path_factory):
    """The user's state directory of all tests and their processes: nothing is written into the real
    one.
    """
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("state")
        patch.setenv("XDG_STATE_HOME", str(folder))
        yield folder


@pytest.fixture(scope="session")
def empty():
    """An output directory with an initialised store: to make one takes seconds."""
    from parking_exp.config.paths import default_uri
    from parking_exp.tracking.client import connect

    with in_memory() as folder:
        connect(default_uri(Path(folder)))
        yield Path(folder)


@pytest.fixture
def output_dir(empty):
    """An output directory with a store of its own."""
    with copy_of(empty) as folder:
        yield folder


@pytest.fixture(scope="session")
def installed_wheel(tmp_path_factory):
    """The folder of a package that was built as a wheel and installed."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--quiet"]
    build = [*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT]
    subprocess.run(build, check=True, capture_output=True, timeout=300)
    (wheel,) = folder.glob("*.whl")
    install = [*pip, "install", "--no-deps", "--target", folder / "site", wheel]
    subprocess.run(install, check=True, capture_output=True, timeout=300)
    return folder / "site"


@pytest.fixture(scope="session")
def smoke_folder(tmp_path_factory):
    """The folder of a finished smoke run's outputs and of what it has printed."""
    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    printed = folder / "smoke" / "printed.json"
    with FileLock(folder / "smoke.lock"):
        if not printed.exists():
            output = f"output_dir={folder / 'smoke' / 'outputs'}"
            done = run_script("train", "experiment=smoke", output, code=0)
            printed.write_text(json.dumps([done.stdout, done.stderr]))
    return folder / "smoke"


@pytest.fixture(scope="session")
def smoke(smoke_folder):
    """The run directory of a finished smoke run.

    All workers of a test session share it: tests read it, and change copies.
    """
    return only_run(smoke_folder / "outputs")


@pytest.fixture
def smoke_copy(smoke, tmp_path):
    """The run directory in a copy of its output directory, with its store."""
    return only_run(shutil.copytree(smoke.output_dir, tmp_path / "outputs"))


@pytest.fixture
def srun(tmp_path_factory, monkeypatch):
    """Put on PATH the one program that submitit looks for to find a Slurm."""
    program = tmp_path_factory.mktemp("slurm") / "srun"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=os.pathsep)


@pytest.fixture(scope="session")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    executable = next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )
    if executable is None:
        reason = "no browser found: apt-get install chromium"
        if os.environ.get("CI", "").lower() not in ("", "0", "false"):
            pytest.fail(reason)
        pytest.skip(reason)
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=executable, args=CHROMIUM_ARGUMENTS)
        yield started
        started.close()


@pytest.fixture
def open_page(browser):
    """Open a file in a browser; at the end nothing may have gone wrong or asked for a second
    file.
    """
    seen = []
    opened = []

    def opening(path, width=1280, **options):
        context = browser.new_context(viewport={"width": width, "height": 900}, **options)
        opened.append(context)
        tab = context.new_page()
        tab.on("console", lambda message: seen.append(f"console: {message.text}"))
        tab.on("pageerror", lambda error: seen.append(f"error: {error}"))
        tab.on(
            "dialog", lambda dialog: (seen.append(f"dialog: {dialog.message}"), dialog.dismiss())
        )
        tab.on(
            "request",
            lambda request: request.url != path.as_uri() and seen.append(f"request: {request.url}"),
        )
        tab.goto(path.as_uri())
        return tab

    yield opening
    for context in opened:
        context.close()
    assert seen == []

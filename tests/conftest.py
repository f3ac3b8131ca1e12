"""Fixtures of all tests: output directories with a store, and a finished run."""

import shutil
from pathlib import Path

import pytest
import torch
from support.runs import in_memory, only_run, run_script

torch.set_num_threads(1)  # networks this small gain nothing from more, and other processes do


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
    with in_memory() as folder:
        shutil.copy(empty / "mlflow.db", folder)
        yield Path(folder)


@pytest.fixture(scope="session")
def smoke(tmp_path_factory):
    """A finished smoke run: (its directory, the completed process, its output directory)."""
    output_dir = tmp_path_factory.mktemp("smoke") / "outputs"
    process = run_script("train", "experiment=smoke", f"output_dir={output_dir}")
    assert process.returncode == 0, process.stderr
    return only_run(output_dir), process, output_dir

"""Tests of cores and CUDA devices, and how workers share them."""

import json
import os

import pytest
from support.runs import run_script
from support.sweep_processes import FAILING, QUICK

from parking_exp.resources import available_cores, cuda_devices, divide_cores


@pytest.mark.parametrize(
    ("n_cores", "n_workers", "expected"),
    [
        (5, 2, [[0, 1], [2, 3, 4]]),
        (2, 3, [[0], [1], [0]]),
    ],
)
def test_cores_are_dealt_out_evenly(n_cores, n_workers, expected):
    assert divide_cores(range(n_cores), n_workers) == expected


@pytest.mark.parametrize(
    ("visible", "expected"),
    [("0,1", ["0", "1"]), ("GPU-a, GPU-b", ["GPU-a", "GPU-b"]), ("", []), ("-1", [])],
)
def test_visible_devices_are_those_that_are_shared_out(monkeypatch, visible, expected):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert cuda_devices() == expected


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(available_cores()) < 2,
    reason="needs two cores to pin to",
)
def test_workers_side_by_side_have_cores_threads_and_devices_of_their_own(tmp_path):
    environment = {**FAILING, "TELLS": str(tmp_path), "CUDA_VISIBLE_DEVICES": "4,5"}
    run_script(
        "train",
        *QUICK,
        f"output_dir={tmp_path / 'outputs'}",
        "seeds=2",
        "algorithm._target_=support.user_algorithms.Tells",
        "torch_threads=null",
        "hydra.launcher.n_jobs=2",
        env=environment,
        code=0,
    )
    workers = sorted(
        (json.loads(path.read_text()) for path in tmp_path.glob("*.json")),
        key=lambda worker: worker["cores"],
    )
    assert [worker["cores"] for worker in workers] == divide_cores(available_cores(), 2)
    assert [worker["devices"] for worker in workers] == ["4", "5"]
    for worker in workers:
        assert {*worker["threads"].values(), str(worker["torch"])} == {str(len(worker["cores"]))}

"""Tests of cores and CUDA devices, and how workers share them."""

import pytest

from parking_exp.sweeps.resources import cuda_devices, divide_cores


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

"""Cores and CUDA devices of this machine, and their division between workers."""

import itertools
import os
from collections.abc import Sequence
from pathlib import Path

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)


def available_cores() -> list[int]:
    """Return the cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def divide_cores(all_cores: Sequence[int], n_workers: int) -> list[list[int]]:
    """Divide cores evenly between workers; if workers outnumber the cores, they share them."""
    if n_workers >= len(all_cores):
        return [[all_cores[worker % len(all_cores)]] for worker in range(n_workers)]
    bounds = [len(all_cores) * worker // n_workers for worker in range(n_workers + 1)]
    return [list(all_cores[low:high]) for low, high in itertools.pairwise(bounds)]


def cuda_devices() -> list[str]:
    """Return the names of the CUDA devices that this process may use, without importing torch."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [name.strip() for name in visible.split(",") if name.strip() not in {"", "-1"}]
    gpus = Path("/proc/driver/nvidia/gpus")
    return [str(number) for number, _ in enumerate(gpus.iterdir())] if gpus.is_dir() else []

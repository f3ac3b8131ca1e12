"""Benchmark sweeps: scaling to two workers, overhead per run, planning of a finished sweep."""

import contextlib
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.timing import spread
from parking_exp.config.compose import composed_runs
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import STATUS_FILE, RunDirectory
from parking_exp.sweeps.local import launch
from parking_exp.sweeps.sweep import plan

BARE = (
    "evaluation.every_n_steps=null",
    "evaluation.final_n_scenes=1",
    "evaluation.n_scenes=1",
    "evaluation.video_episodes=0",
)
SHORT = (
    "n_envs=8",
    "updates_per_step=1",
    "env.duration=4",
    "env.training_duration=2",
    "algorithm.learning_starts=100",
    "total_timesteps=108",
)


def scaling(rounds: int, steps: int | None, all_cores: Sequence[int]) -> dict[str, Any]:
    """Compare runs per hour of two workers with one; runs train for `steps` env steps (None: as in `overhead`)."""
    length = SHORT if steps is None else (f"total_timesteps={steps}",)
    ratios = []
    with _cores(all_cores), tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            seconds = []
            for workers in (1, 2):
                paths = _frozen(Path(folder) / f"{number}-{workers}", "seeds=2", *BARE, *length)
                seconds.append(_seconds(paths, workers))
            ratios.append(seconds[0] / seconds[1])
    peer = f"the same two runs of {steps or 108} steps, one after the other"
    return spread(ratios, "ratio") | {"peer": peer, "cores": len(all_cores)}


def overhead(rounds: int, all_cores: Sequence[int]) -> dict[str, Any]:
    """Measure the seconds of a run of 108 env steps and 8 updates.

    These are its start and its end: final model, curves, artifacts. The final evaluation and the cross-check are a
    single scene of at most 20 steps.
    """
    values = []
    with _cores(all_cores), tempfile.TemporaryDirectory() as folder:
        for number in range(rounds + 1):
            values.append(_seconds(_frozen(Path(folder), f"seed={number}", *BARE, *SHORT), 1))
    return spread(values[1:], "seconds") | {
        "peer": "",
        "unit": "seconds per run, besides training",
    }  # the first run created the store


def scan(rounds: int, n_seeds: int, *cells: str) -> dict[str, Any]:
    """Measure the seconds to plan the cells of `her_ablation`, or some of them, whose runs are finished."""
    with tempfile.TemporaryDirectory() as folder:
        runs = composed_runs("config", ["experiment=her_ablation", *cells, f"seeds={n_seeds}", f"output_dir={folder}"])
        for run in plan(runs):
            run.path.mkdir(parents=True)
            entries = {"status": "done", "steps": 20_000, "label": run.label}
            write_json(run.path / STATUS_FILE, entries, durable=False)
        values = []
        for _ in range(rounds):
            begin = time.perf_counter()
            planned = plan(runs)
            values.append(time.perf_counter() - begin)
        assert not any(run.is_due for run in planned)
    return spread(values, "seconds") | {"peer": "", "unit": f"seconds for {len(runs)} finished runs"}


def _frozen(output_dir: Path, *overrides: str) -> list[Path]:
    """Write the configs of runs into their directories, and return these."""
    planned = plan(composed_runs("config", [*overrides, f"output_dir={output_dir}"]))
    for run in planned:
        RunDirectory(run.path).freeze(run.config, run.label, None)
    return [run.path for run in planned]


def _seconds(paths: Sequence[Path], workers: int) -> float:
    begin = time.perf_counter()
    endings = launch(paths, workers)
    seconds = time.perf_counter() - begin
    if set(endings.values()) != {"done"}:
        raise RuntimeError(f"a timed run failed: {endings}")
    return seconds


@contextlib.contextmanager
def _cores(allowed: Sequence[int]) -> Iterator[None]:
    """Allow other cores than the one that the benchmark is pinned to."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, allowed)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)

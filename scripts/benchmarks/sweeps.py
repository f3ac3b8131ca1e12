"""Benchmarks of sweeps: scaling to two workers, overhead of a run, planning of a sweep that is done."""

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
from parking_exp.sweeps.plan import plan

BARE = (
    "evaluation.every_n_steps=null",
    "evaluation.final_n_scenes=1",
    "evaluation.n_scenes=1",
    "evaluation.video_episodes=0",
)
MOMENT = (
    "n_envs=8",
    "updates_per_step=1",
    "env.duration=4",
    "env.training_duration=2",
    "algorithm.learning_starts=100",
    "total_timesteps=108",
)


def scaling(rounds: int, steps: int | None, all_cores: Sequence[int]) -> dict[str, Any]:
    """Compare two workers with one: runs an hour, each with its start, its end and `steps` of the default training.

    None: of training for a moment, as `overhead` has it.
    """
    length = MOMENT if steps is None else (f"total_timesteps={steps}",)
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
    """Measure a run's seconds besides training: those of a run that trains for a moment, 108 steps and 8 updates.

    That is its start, to the first env step, and its end: final model, curves, all artifacts to the store. The final
    evaluation and its certification are a single scene of at most 20 steps.
    """
    values = []
    with _cores(all_cores), tempfile.TemporaryDirectory() as folder:
        for number in range(rounds + 1):
            values.append(_seconds(_frozen(Path(folder), f"seed={number}", *BARE, *MOMENT), 1))
    return spread(values[1:], "seconds") | {
        "peer": "",
        "unit": "seconds a run, besides its training",
    }  # the first made the store


def scan(rounds: int, n_seeds: int, *cells: str) -> dict[str, Any]:
    """Measure how long it takes to check the cells of `her_ablation`, or some of them, and look up their runs."""
    with tempfile.TemporaryDirectory() as folder:
        runs = composed_runs("config", ["experiment=her_ablation", *cells, f"seeds={n_seeds}", f"output_dir={folder}"])
        for run in plan(runs):
            run.path.mkdir(parents=True)
            entries = {"status": "done", "steps": 20_000, "label": run.label}
            write_json(run.path / STATUS_FILE, entries, durable=False)
        values = []
        for _ in range(rounds):
            begin = time.perf_counter()
            found = plan(runs)
            values.append(time.perf_counter() - begin)
        assert not any(run.is_due for run in found)
    return spread(values, "seconds") | {"peer": "", "unit": f"seconds for {len(runs)} finished runs"}


def _frozen(output_dir: Path, *overrides: str) -> list[Path]:
    """Freeze runs, and return their directories."""
    planned = plan(composed_runs("config", [*overrides, f"output_dir={output_dir}"]))
    for run in planned:
        RunDirectory(run.path).freeze(run.config, run.label, None)
    return [run.path for run in planned]


def _seconds(paths: Sequence[Path], workers: int) -> float:
    begin = time.perf_counter()
    endings = launch(paths, workers)
    seconds = time.perf_counter() - begin
    if set(endings.values()) != {"done"}:
        raise RuntimeError(f"a run that was to be timed has failed: {endings}")
    return seconds


@contextlib.contextmanager
def _cores(some: Sequence[int]) -> Iterator[None]:
    """Use more cores than the one that everything else is pinned to."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, some)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)

"""Benchmark sweeps: scaling to two workers, overhead per run, planning of a finished sweep."""

import contextlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.timing import seconds, spread
from parking_exp.config.compose import compose_runs
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.run_files import STATUS_FILE
from parking_exp.runs.run_plans import write_plan
from parking_exp.sweeps.local import LocalLauncher
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


def scaling(rounds: int, length: Sequence[str], all_cores: Sequence[int]) -> dict[str, Any]:
    """Compare runs per hour of two workers with one; `length` are the overrides of a run."""
    ratios = []
    with _allowed(all_cores), tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            one, two = (
                _launch_seconds(
                    Path(folder) / f"{number}-{workers}", workers, "seeds=2", *BARE, *length
                )
                for workers in (1, 2)
            )
            ratios.append(one / two)
    return spread(ratios) | {
        "peer": "the same two runs, one after the other",
        "cores": len(all_cores),
    }


def overhead(rounds: int, all_cores: Sequence[int]) -> dict[str, Any]:
    """Measure a run's seconds besides training: 108 env steps, 8 updates, one evaluated scene."""
    with _allowed(all_cores), tempfile.TemporaryDirectory() as folder:
        values = [
            _launch_seconds(Path(folder), 1, f"seed={seed}", *BARE, *SHORT)
            for seed in range(rounds + 1)
        ]
    return spread(values[1:])  # the first run warms up


def scan(rounds: int, n_seeds: int, *cells: str) -> dict[str, Any]:
    """Measure the seconds to plan cells of `her_ablation`, all or some, whose runs are finished."""
    with tempfile.TemporaryDirectory() as folder:
        runs = compose_runs(
            "config",
            ["experiment=her_ablation", *cells, f"seeds={n_seeds}", f"output_dir={folder}"],
        )
        for run in plan(runs):
            run.path.mkdir(parents=True)
            entries = {"status": "done", "steps": 20_000, "label": run.label}
            write_json(run.path / STATUS_FILE, entries, durable=False)
        values = [seconds(lambda: plan(runs)) for _ in range(rounds)]
        assert not any(run.is_due for run in plan(runs))
    return spread(values) | {"unit": f"seconds for {len(runs)} finished runs"}


def _launch_seconds(output_dir: Path, workers: int, *overrides: str) -> float:
    """Return the seconds that the runs of some overrides take."""
    planned = plan(compose_runs("config", [*overrides, f"output_dir={output_dir}"]))
    for run in planned:
        write_plan(RunDirectory(run.path), run.config, run.label, None)
    duration = seconds(lambda: LocalLauncher(workers).train([run.path for run in planned]))
    if any(RunDirectory(run.path).status != "done" for run in planned):
        raise RuntimeError(f"a timed run failed; see {output_dir}")
    return duration


@contextlib.contextmanager
def _allowed(cores: Sequence[int]) -> Iterator[None]:
    """Allow cores beside the one that the benchmark is pinned to, if the system supports it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)

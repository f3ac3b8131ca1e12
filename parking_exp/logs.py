"""Append-only files of a run: metrics and episodes, written here first and sent to MLflow from here."""

import json
import numbers
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from parking_exp.files import sync

APPENDED = ["metrics.jsonl", "episodes.csv", "monitor.csv"]
"""Files of a run directory that only ever grow."""


def sync_logs(run_dir: Path) -> dict[str, int]:
    """Wait until the append-only files are on the disk, and return the size of each, in bytes."""
    found = [run_dir / name for name in APPENDED if (run_dir / name).exists()]
    for path in found:
        sync(path)
    return {path.name: path.stat().st_size for path in found}


def cut_back(run_dir: Path, sizes: Mapping[str, int]) -> None:
    """Cut each append-only file back to an earlier size: what was written after it is going to be done again."""
    for name in APPENDED:
        path = run_dir / name
        if path.exists():
            if name in sizes:
                os.truncate(path, sizes[name])
            else:
                path.unlink()


class MetricsLog:
    """`metrics.jsonl`: one line {"step", "time_ms", "metrics"} for each row of metrics.

    A key has one value per step, the first: several training episodes that end in the same step make
    Stable-Baselines3's logger write twice.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._last_step = {key: record["step"] for record in self.records() for key in record["metrics"]}

    def append(self, step: int, values: Mapping[str, Any]) -> dict[str, float]:
        """Append a row of the numbers among `values`, and return it; it may be empty, and then nothing is written."""
        metrics = {
            key: float(value)
            for key, value in values.items()
            if isinstance(value, numbers.Real) and self._last_step.get(key, -1) < step
        }
        if metrics:
            self._last_step |= dict.fromkeys(metrics, step)
            line = json.dumps({"step": step, "time_ms": time.time_ns() // 1_000_000, "metrics": metrics})
            with self.path.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
        return metrics

    def records(self) -> Iterator[dict[str, Any]]:
        """Yield the rows so far."""
        if self.path.exists():
            with self.path.open(encoding="utf-8") as file:
                for line in file:
                    yield json.loads(line)

    def latest(self) -> dict[str, float]:
        """Return the last value of every metric."""
        return {key: value for record in self.records() for key, value in record["metrics"].items()}

    def frame(self) -> pd.DataFrame:
        """Return one row per step, one column per metric; empty cells are NaN."""
        rows = [{"step": record["step"], **record["metrics"]} for record in self.records()]
        return pd.DataFrame(rows, columns=None if rows else ["step"]).groupby("step").first().reset_index()


def append_episodes(path: Path, episodes: pd.DataFrame, phase: str, step: int) -> None:
    """Append an evaluation's episodes to `episodes.csv`, with its phase (`eval` or `final`) and env step."""
    table = episodes.assign(phase=phase, step=step)
    table = table[["phase", "step", *episodes.columns]]
    table.to_csv(path, mode="a", header=not path.exists(), index=False)

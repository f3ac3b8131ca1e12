"""The append-only logs of a run, and their copies in checkpoints."""

import json
import numbers
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parking_exp.runs.foreign_files import open_file

if TYPE_CHECKING:
    import pandas as pd

METRICS_FILE = "metrics.jsonl"
EPISODES_FILE = "episodes.csv"
MONITOR_FILE = "monitor.csv"
LOGS = (METRICS_FILE, EPISODES_FILE, MONITOR_FILE)
"""Logs of a run. Each checkpoint has a copy of them, which a resumed run gets back."""


def copy_logs(run_dir: Path, checkpoint: Path) -> None:
    """Copy the logs into a checkpoint, with an empty `metrics.jsonl` if there is none yet."""
    for name in LOGS:
        if (run_dir / name).exists():
            shutil.copyfile(run_dir / name, checkpoint / name)
    (checkpoint / METRICS_FILE).touch()


def restore_logs(run_dir: Path, checkpoint: Path | None) -> None:
    """Replace the logs by a checkpoint's, or delete them."""
    for name in LOGS:
        (run_dir / name).unlink(missing_ok=True)
        if checkpoint is not None and (checkpoint / name).exists():
            shutil.copyfile(checkpoint / name, run_dir / name)


def read_metrics(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a `metrics.jsonl`, without a last line that is still being written."""
    if path.exists():
        with open_file(path) as file:
            for line in file:
                if line.endswith(b"\n"):
                    yield json.loads(line)


class MetricsLog:
    """`metrics.jsonl`: one line {"step", "time_ms", "metrics"} for each row of metrics.

    Only the first value of a key at a step is kept: Stable-Baselines3 logs twice if two episodes
    end in the same step.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._last_step: dict[str, int] = {}
        for record in read_metrics(self.path):
            self._last_step |= dict.fromkeys(record["metrics"], record["step"])

    def append(self, step: int, values: Mapping[str, Any]) -> dict[str, float]:
        """Append the numbers among `values` as a row, if there are any, and return the row."""
        metrics = {}
        for key, value in values.items():
            if isinstance(value, numbers.Real) and self._last_step.get(key, -1) < step:
                metrics[key] = float(value)
        if metrics:
            self._last_step |= dict.fromkeys(metrics, step)
            row = {"step": step, "time_ms": time.time_ns() // 1_000_000, "metrics": metrics}
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
        return metrics

    def latest(self) -> dict[str, float]:
        """Return the last value of every metric."""
        values: dict[str, float] = {}
        for record in read_metrics(self.path):
            values |= record["metrics"]
        return values

    def frame(self) -> "pd.DataFrame":
        """Return one row per step, one column per metric; empty cells are NaN."""
        import pandas as pd  # not where a store is only synced

        rows = [{"step": record["step"], **record["metrics"]} for record in read_metrics(self.path)]
        if not rows:
            return pd.DataFrame(columns=["step"])
        return pd.DataFrame(rows).groupby("step").first().reset_index()


def append_episodes(path: Path, episodes: "pd.DataFrame", phase: str, step: int) -> None:
    """Append an evaluation's episodes to `episodes.csv`, with its phase and env step."""
    table = episodes.assign(phase=phase, step=step)[["phase", "step", *episodes.columns]]
    if path.exists():  # rows of a metric that was added since would not fit under the header
        with path.open(encoding="utf-8") as file:
            table = table.reindex(columns=file.readline().strip().split(","))
    table.to_csv(path, mode="a", header=not path.exists(), index=False)

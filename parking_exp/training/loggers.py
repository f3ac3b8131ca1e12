"""Stable-Baselines3 logger with a run's outputs: metrics.jsonl, progress.csv, TensorBoard, stdout."""

import numbers
import sys
import threading
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import CSVOutputFormat, HumanOutputFormat, KVWriter, Logger
from torch.utils.tensorboard import SummaryWriter

from parking_exp.config.schema import TrackingConfig
from parking_exp.runs.metric_logs import MetricsLog


def make_logger(tracking: TrackingConfig, run_dir: Path, metrics: MetricsLog, step: int) -> Logger:
    """Make a run's logger, which continues after `step` if the run is resumed."""
    formats: list[KVWriter] = [_MetricsWriter(metrics, run_dir / "progress.csv" if tracking.csv else None)]
    if tracking.tensorboard:
        formats.append(_TensorBoardWriter(run_dir / "tensorboard", step))
    if tracking.stdout:
        formats.append(HumanOutputFormat(sys.stdout))
    return Logger(str(run_dir), formats)


class _MetricsWriter(KVWriter):
    """Writes to metrics.jsonl, and what that accepts to progress.csv, which starts as a copy of metrics.jsonl."""

    def __init__(self, metrics: MetricsLog, csv: Path | None) -> None:
        self.metrics = metrics
        self.table = CSVOutputFormat(str(csv)) if csv else None
        for record in metrics.records():
            self._add_row(record["metrics"], record["step"])

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        self._add_row(self.metrics.append(step, key_values), step)

    def close(self) -> None:
        if self.table is not None:
            self.table.close()

    def _add_row(self, row: dict[str, float], step: int) -> None:
        if row and self.table is not None:
            self.table.write(row, dict.fromkeys(row, ()), step)


class _TensorBoardWriter(KVWriter):
    """Writes to TensorBoard, with `purge_step`, which Stable-Baselines3's own writer lacks."""

    def __init__(self, folder: Path, step: int) -> None:
        # Also at step 0: a run that was killed before its first checkpoint has old events.
        self.writer = SummaryWriter(str(folder), purge_step=step + 1)
        threading.excepthook = _print_thread_error

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        for key, value in key_values.items():
            if isinstance(value, numbers.Real) and "tensorboard" not in (key_excluded[key] or ()):
                self.writer.add_scalar(key, value, step)
        self.writer.flush()

    def close(self) -> None:
        self.writer.close()


def _print_thread_error(arguments: threading.ExceptHookArgs) -> None:
    """Print the traceback of a thread, except TensorBoard's on a full disk, which `flush` raises as well."""
    if not type(arguments.thread).__module__.startswith("tensorboard."):
        threading.__excepthook__(arguments)

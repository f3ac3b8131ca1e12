"""Stable-Baselines3 logger with a run's outputs: metrics.jsonl, progress.csv, TensorBoard, stdout."""

import sys
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import (
    CSVOutputFormat,
    HumanOutputFormat,
    KVWriter,
    Logger,
    TensorBoardOutputFormat,
)

from parking_exp.config.schema import TrackingConfig
from parking_exp.runs.metric_logs import MetricsLog


def make_logger(tracking: TrackingConfig, run_dir: Path, metrics: MetricsLog) -> Logger:
    """Make a run's logger, which continues the files of a run that is resumed."""
    formats: list[KVWriter] = [_MetricsWriter(metrics, run_dir / "progress.csv" if tracking.csv else None)]
    if tracking.tensorboard:
        formats.append(TensorBoardOutputFormat(str(run_dir / "tensorboard")))
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

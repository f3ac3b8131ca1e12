"""Stable-Baselines3's logger with the outputs that a run wants."""

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
from torch.utils.tensorboard import SummaryWriter

from parking_exp.config import TrackingConfig
from parking_exp.logs import MetricsLog


def make_logger(tracking: TrackingConfig, run_dir: Path, metrics: MetricsLog, step: int) -> Logger:
    """Make a run's logger: `metrics.jsonl` always, progress.csv, TensorBoard and stdout as configured.

    `step` is where the run starts: progress.csv is written anew from the rows so far, and TensorBoard is told to
    forget what came after.
    """
    table = _csv(run_dir / "progress.csv", metrics) if tracking.csv else None
    formats: list[KVWriter] = [_MetricsWriter(metrics, table)]
    if tracking.tensorboard:
        board = TensorBoardOutputFormat(str(run_dir / "tensorboard"))
        board.writer.close()
        # Also at step 0: a run that was killed before its first checkpoint starts anew beside its old events.
        board.writer = SummaryWriter(str(run_dir / "tensorboard"), purge_step=step + 1)
        formats.append(board)
    if tracking.stdout:
        formats.append(HumanOutputFormat(sys.stdout))
    return Logger(str(run_dir), formats)


class _MetricsWriter(KVWriter):
    """Passes the logger's rows on to a MetricsLog, and what that takes of them to a table, which so has the same."""

    def __init__(self, metrics: MetricsLog, table: CSVOutputFormat | None) -> None:
        self.metrics, self.table = metrics, table

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        row = self.metrics.append(step, key_values)
        if row and self.table is not None:
            _add(self.table, row, step)

    def close(self) -> None:
        """Close the table; the log's rows are on their way to the disk already."""
        if self.table is not None:
            self.table.close()


def _csv(path: Path, metrics: MetricsLog) -> CSVOutputFormat:
    """Open a progress.csv that begins with what the run has logged before."""
    table = CSVOutputFormat(str(path))
    for record in metrics.records():
        _add(table, record["metrics"], record["step"])
    return table


def _add(table: CSVOutputFormat, row: dict[str, float], step: int) -> None:
    table.write(row, dict.fromkeys(row, ()), step)

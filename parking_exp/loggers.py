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

    `step` is where the run starts: rows up to there are written to progress.csv again, and TensorBoard is told to
    forget what came after.
    """
    formats: list[KVWriter] = [_MetricsWriter(metrics)]
    if tracking.csv:
        formats.append(_csv(run_dir / "progress.csv", metrics))
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
    """Passes the logger's rows on to a MetricsLog."""

    def __init__(self, metrics: MetricsLog) -> None:
        self.metrics = metrics

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        self.metrics.append(step, key_values)

    def close(self) -> None:
        """Do nothing: every row is on its way to the disk already."""


def _csv(path: Path, metrics: MetricsLog) -> CSVOutputFormat:
    """Open a progress.csv that begins with what the run has logged before."""
    table = CSVOutputFormat(str(path))
    for record in metrics.records():
        table.write(record["metrics"], dict.fromkeys(record["metrics"], ()), record["step"])
    return table

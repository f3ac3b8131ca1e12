"""Stable-Baselines3 logger with a run's outputs: metrics.jsonl, progress.csv, TensorBoard, stdout."""

import numbers
import os
import socket
import sys
import time
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import (
    CSVOutputFormat,
    HumanOutputFormat,
    KVWriter,
    Logger,
)
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.summary.writer.record_writer import RecordWriter
from torch.utils.tensorboard.summary import scalar

from parking_exp.config.schema import TrackingConfig
from parking_exp.runs.metric_logs import MetricsLog


def make_logger(tracking: TrackingConfig, run_dir: Path, metrics: MetricsLog, step: int) -> Logger:
    """Make a run's logger: `metrics.jsonl` always, progress.csv, TensorBoard and stdout as configured.

    `step` is where the run starts: progress.csv is written anew from the rows so far, and TensorBoard is told to
    forget what came after.
    """
    table = _csv(run_dir / "progress.csv", metrics) if tracking.csv else None
    formats: list[KVWriter] = [_MetricsWriter(metrics, table)]
    if tracking.tensorboard:
        formats.append(_EventWriter(run_dir / "tensorboard", step))
    if tracking.stdout:
        formats.append(HumanOutputFormat(sys.stdout))
    return Logger(str(run_dir), formats)


class _MetricsWriter(KVWriter):
    """Writes the logger's rows to a MetricsLog, and the values that it accepts to progress.csv as well."""

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


class _EventWriter(KVWriter):
    """Writes the numbers of the logger's rows to a TensorBoard event file.

    TensorBoard's own writer has a thread for it, which prints a traceback when the disk is full. Here that is an error
    of the row.

    Args:
        folder: of event files.
        step: TensorBoard forgets what earlier files have after it. Also at step 0: a run that was killed before its
            first checkpoint starts anew beside its old events.
    """

    def __init__(self, folder: Path, step: int) -> None:
        folder.mkdir(exist_ok=True)
        name = f"events.out.tfevents.{int(time.time()):010d}.{socket.gethostname()}.{os.getpid()}"
        self._file = (folder / name).open("ab")
        self._records = RecordWriter(self._file)
        self._add(file_version="brain.Event:2")
        self._add(session_log=SessionLog(status=SessionLog.START), step=step + 1)
        self._file.flush()

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        for key, value in sorted(key_values.items()):
            if isinstance(value, numbers.Real) and "tensorboard" not in (key_excluded[key] or ()):
                self._add(summary=scalar(key, value), step=step)
        self._file.flush()

    def close(self) -> None:
        """Close the file; its rows are on their way to the disk already."""
        self._file.close()

    def _add(self, **values: Any) -> None:
        self._records.write(Event(wall_time=time.time(), **values).SerializeToString())


def _csv(path: Path, metrics: MetricsLog) -> CSVOutputFormat:
    """Open a progress.csv that begins with what the run has logged before."""
    table = CSVOutputFormat(str(path))
    for record in metrics.records():
        _add(table, record["metrics"], record["step"])
    return table


def _add(table: CSVOutputFormat, row: dict[str, float], step: int) -> None:
    table.write(row, dict.fromkeys(row, ()), step)

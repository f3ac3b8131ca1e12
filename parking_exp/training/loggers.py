"""A run's logger, for metrics.jsonl, progress.csv, TensorBoard and stdout."""

import numbers
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import (
    CSVOutputFormat,
    HumanOutputFormat,
    KVWriter,
    Logger,
    TensorBoardOutputFormat,
)
from tensorboard.compat.proto.summary_pb2 import Summary

from parking_exp.config.schema import TrackingConfig
from parking_exp.runs.metric_logs import MetricsLog, read_metrics
from parking_exp.runs.run_files import PROGRESS_FILE

TENSORBOARD_DIR = "tensorboard"
# TensorBoard sorts its groups by name and opens the first. With these names it is `eval/`.
GROUPS_IN_TENSORBOARD = {"buffer/": "replay/", "certified/": "final/certified_"}
MAX_NAME_LENGTH = 60


def make_logger(
    tracking: TrackingConfig,
    run_dir: Path,
    metrics_log: MetricsLog,
    label: str,
    on_row: Callable[[int, dict[str, float]], None],
) -> Logger:
    """Make a run's logger.

    `progress.csv` and TensorBoard's files are made anew from `metrics.jsonl`: a run that is resumed
    has each step once.

    Args:
        tracking: which outputs the run has.
        run_dir: where they are.
        metrics_log: the log of the run so far, which is continued.
        label: the label of the run's cell; TensorBoard names a run by its folder.
        on_row: called with the step and the metrics of each new row.
    """
    table = CSVOutputFormat(str(run_dir / PROGRESS_FILE)) if tracking.csv else None
    board = None
    if tracking.tensorboard:
        shutil.rmtree(run_dir / TENSORBOARD_DIR, ignore_errors=True)
        board = TensorBoardOutputFormat(str(run_dir / TENSORBOARD_DIR / _folder_name(label)))
    formats: list[KVWriter] = [_MetricsWriter(metrics_log, table, board, on_row)]
    if tracking.stdout:
        formats.append(HumanOutputFormat(sys.stdout))
    return Logger(str(run_dir), formats)


def _folder_name(label: str) -> str:
    """Return a label as the name of a folder."""
    return re.sub(r"[^\w .,=+-]", "_", label)[:MAX_NAME_LENGTH].strip(" .") or "run"


def _tensorboard_tag(key: str) -> str:
    """Return the name of a metric in TensorBoard."""
    for group, shown in GROUPS_IN_TENSORBOARD.items():
        if key.startswith(group):
            return shown + key.removeprefix(group)
    return key


class _MetricsWriter(KVWriter):
    """Writes rows to metrics.jsonl, and the rows that it accepts to the other files.

    The other files start as copies of metrics.jsonl.
    """

    def __init__(
        self,
        metrics_log: MetricsLog,
        table: CSVOutputFormat | None,
        board: TensorBoardOutputFormat | None,
        on_row: Callable[[int, dict[str, float]], None],
    ) -> None:
        self.metrics_log = metrics_log
        self.table = table
        self.board = board
        self.on_row = on_row
        for record in read_metrics(metrics_log.path):
            self._add_row(record["metrics"], record["step"], record["time_ms"] / 1000)

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        row = self.metrics_log.append(step, key_values)
        self._add_row(row, step)
        if row:
            self.on_row(step, row)
        if self.board is not None:
            others = {}
            excluded = {}
            for key, value in key_values.items():
                if not isinstance(value, numbers.Real):
                    others[key] = value
                    excluded[key] = key_excluded[key]
            self.board.write(others, excluded, step)  # figures; and it flushes

    def close(self) -> None:
        if self.table is not None:
            self.table.close()
        if self.board is not None:
            self.board.close()

    def _add_row(self, row: dict[str, float], step: int, time_s: float | None = None) -> None:
        if not row:
            return
        if self.table is not None:
            self.table.write(row, dict.fromkeys(row, ()), step)
        if self.board is not None:
            # One event for the row: an event for each value takes more time than all other logs.
            values = [
                Summary.Value(tag=_tensorboard_tag(key), simple_value=value)
                for key, value in row.items()
            ]
            writer: Any = self.board.writer.file_writer
            writer.add_summary(Summary(value=values), step, time_s)

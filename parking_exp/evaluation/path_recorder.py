"""Record the paths of some episodes while they are evaluated."""

import gzip
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from parking_exp.runs.atomic_files import replacing
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.tasks.task import EvaluationBatch, Task


class PathRecorder:
    """The paths of some episodes, as far as they have been evaluated.

    Args:
        task: that is evaluated; one without positions has no paths.
        seeds: of the episodes whose paths are recorded.
    """

    def __init__(self, task: Task, seeds: Sequence[int]) -> None:
        self._task = task
        self._seeds = list(seeds)
        self._columns = [EPISODE_SEED, "step"]
        self._rows: list[np.ndarray] = []

    def record(self, batch: EvaluationBatch, seeds: np.ndarray, step: int) -> None:
        """Record where the episodes of a batch are after a step, 0 at the start.

        The seeds are those of the batch's episodes, shape (n,).
        """
        is_recorded = np.isin(seeds, self._seeds)
        if not is_recorded.any():
            return
        positions = self._task.positions(batch)
        rows = np.column_stack([seeds, np.full(len(seeds), step), *positions.values()])
        self._rows.append(rows[is_recorded])
        self._columns[2:] = positions

    def table(self) -> pd.DataFrame:
        """Return a row for each step of each episode: seed, step and position."""
        rows = np.concatenate(self._rows)
        paths = pd.DataFrame(rows, columns=self._columns)
        paths = paths.astype({EPISODE_SEED: "int64", "step": "int64"})
        return paths.sort_values([EPISODE_SEED, "step"], ignore_index=True)

    def write(self, path: Path) -> None:
        """Write the paths as gzipped CSV, if the task has positions.

        Equal paths have equal bytes: the time in the file is always the same.
        """
        paths = self.table()
        if len(paths.columns) == 2:
            return
        text = paths.to_csv(index=False, float_format="%.3f")
        with replacing(path) as temporary:
            temporary.write_bytes(gzip.compress(text.encode(), mtime=1))

"""Record the paths of some episodes while they are evaluated."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from parking_exp.runs.atomic_files import write_gzip
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.tasks.task import Observation, Task


class PathRecorder:
    """The paths of some episodes, as far as they have been evaluated.

    Args:
        task: the task that is evaluated; one without positions has no paths.
        seeds: seeds of the episodes whose paths are recorded.
    """

    def __init__(self, task: Task, seeds: Sequence[int]) -> None:
        self._task = task
        self._seeds = list(seeds)
        self._parts: list[pd.DataFrame] = []

    def record(self, observation: Observation, seeds: np.ndarray, step: int) -> None:
        """Record where n episodes are after a step, 0 at the start; seeds have the shape (n,)."""
        is_recorded = np.isin(seeds, self._seeds)
        if not is_recorded.any():
            return
        positions = self._task.positions(observation)
        if positions:
            columns = {EPISODE_SEED: seeds, "step": step, **positions}
            self._parts.append(pd.DataFrame(columns)[is_recorded])

    def table(self) -> pd.DataFrame:
        """Return a row for each step of each episode: seed, step and position."""
        paths = pd.concat(self._parts)
        return paths.sort_values([EPISODE_SEED, "step"], ignore_index=True)

    def write(self, path: Path) -> None:
        """Write the paths as gzipped CSV, rounded to 0.001, if the task has positions."""
        if self._parts:
            write_gzip(path, self.table().to_csv(index=False, float_format="%.3f"))

"""Curves and final episodes of each run, as arrays: a thousand look-ups in frames are slow."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from parking_exp.outcomes import Outcome
from parking_exp.results import Results

OUTCOMES: tuple[Outcome, ...] = ("success", "crash", "timeout")


@dataclass(frozen=True)
class Course:
    """A run's evaluations during training that have a success rate, shape (n,) each, n >= 1; NaN: not logged.

    Attributes:
        step: env steps.
        success, crash: rates.
        cpu_s: CPU seconds of the run until then; what the last one says includes how the run ended.
        real_share: of the transitions that the buffer sampled.
    """

    step: np.ndarray
    success: np.ndarray
    crash: np.ndarray
    cpu_s: np.ndarray
    real_share: np.ndarray

    @property
    def trained_s(self) -> float:
        """CPU seconds up to which the run was watched. Its last row includes the final evaluation and certification,
        which may take longer than the training did.
        """
        return float(self.cpu_s[-2 if len(self.cpu_s) > 1 else -1])


@dataclass(frozen=True)
class Certified:
    """A run's final episodes on real highway-env: their scenes and indices into OUTCOMES, shape (n,)."""

    scene: np.ndarray
    outcome: np.ndarray


@dataclass(frozen=True)
class Courses:
    """Of each run that has them, by run id."""

    curves: dict[str, Course]
    certified: dict[str, Certified]

    @staticmethod
    def of(results: Results) -> "Courses":
        """Split the frames of some results."""
        curves = results.curves[results.curves["success_rate"].notna()]
        names = ("step", "success_rate", "crash_rate", "cpu_s", "real_share")
        episodes = results.episodes[results.episodes["phase"] == "certified"]
        outcome = pd.Categorical(episodes["outcome"].astype(str), OUTCOMES).codes
        return Courses(
            {run: Course(*parts) for run, parts in _split(curves["run_id"], *(curves[name] for name in names))},
            {run: Certified(*parts) for run, parts in _split(episodes["run_id"], episodes["scene"], outcome)},
        )


def _split(run_ids: pd.Series, *columns: "pd.Series | np.ndarray") -> Iterator[tuple[str, list[np.ndarray]]]:
    """Yield each run with its part of the columns; rows of a run stand together."""
    ids, arrays = run_ids.to_numpy(), [np.asarray(column) for column in columns]
    starts: list[int] = np.flatnonzero(np.r_[True, ids[1:] != ids[:-1]]).tolist() if len(ids) else []
    for start, end in zip(starts, [*starts, len(ids)][1:], strict=True):
        yield str(ids[start]), [array[start:end] for array in arrays]

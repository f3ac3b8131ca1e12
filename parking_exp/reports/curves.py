"""Evaluation curves and final episodes of each run, as arrays: a thousand look-ups in frames are slow."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from parking_exp.results.frames import Results


@dataclass(frozen=True)
class EvaluationCurve:
    """A run's evaluations during training, shape (n,) each, n >= 1; NaN: not logged.

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

    def watched(self, hold: int) -> tuple[float, float]:
        """Return env step and CPU second of the last evaluation from which `hold` in a row could be seen; 0 without.

        That leaves out the last row, whose CPU seconds include how the run ended.
        """
        if len(self.step) < hold:
            return 0.0, 0.0
        return float(self.step[-hold]), float(self.cpu_s[-hold])


@dataclass(frozen=True)
class FinalEpisodes:
    """A run's final episodes: their scenes and indices into `outcomes.OUTCOMES`, shape (n,)."""

    scene: np.ndarray
    outcome: np.ndarray


@dataclass(frozen=True)
class RunEvaluations:
    """Evaluation curves and final episodes by run id, of the runs that have them."""

    curves: dict[str, EvaluationCurve]
    final: dict[str, FinalEpisodes]

    @staticmethod
    def of(results: Results) -> "RunEvaluations":
        """Split the frames of some results."""
        rated = results.curves.loc[results.curves["success_rate"].notna(), "run_id"]
        curves = results.curves[results.curves["run_id"].isin(rated)]
        names = ("step", "success_rate", "crash_rate", "cpu_s", "real_share")
        episodes = results.episodes[results.episodes["phase"] == "final"]
        outcome = episodes["outcome"].cat.codes
        return RunEvaluations(
            {
                run: EvaluationCurve(*parts)
                for run, parts in _split(curves["run_id"], *(curves[name] for name in names))
            },
            {run: FinalEpisodes(*parts) for run, parts in _split(episodes["run_id"], episodes["scene"], outcome)},
        )


def _split(run_ids: pd.Series, *columns: "pd.Series | np.ndarray") -> Iterator[tuple[str, list[np.ndarray]]]:
    """Yield each run with its part of the columns; rows of a run stand together."""
    ids, arrays = run_ids.to_numpy(), [np.asarray(column) for column in columns]
    starts: list[int] = np.flatnonzero(np.r_[True, ids[1:] != ids[:-1]]).tolist() if len(ids) else []
    for start, end in zip(starts, [*starts, len(ids)][1:], strict=True):
        yield str(ids[start]), [array[start:end] for array in arrays]

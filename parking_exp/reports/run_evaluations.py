"""Evaluation curves and final episodes of each run, as arrays: a thousand look-ups in frames are slow."""

from collections.abc import Iterable
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
        cpu_s: CPU seconds of the run until then; the last one includes how the run ended.
        real_share: of the transitions that the buffer sampled.
    """

    step: np.ndarray
    success: np.ndarray
    crash: np.ndarray
    cpu_s: np.ndarray
    real_share: np.ndarray

    def watched(self, hold: int) -> tuple[float, float]:
        """Return env step and CPU second of the last evaluation from which `hold` in a row could be seen; 0 without."""
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
        rated = results.curves.loc[results.curves["success_rate"].notna(), "run_id"].unique()
        curves = results.curves[results.curves["run_id"].isin(rated)]
        columns = [curves[name] for name in ("step", "success_rate", "crash_rate", "cpu_s", "real_share")]
        episodes = results.episodes[results.episodes["phase"] == "final"]
        ended = [episodes["scene"], episodes["outcome"].cat.codes]
        return RunEvaluations(
            {run: EvaluationCurve(*arrays) for run, arrays in _by_run(curves["run_id"], columns)},
            {run: FinalEpisodes(*arrays) for run, arrays in _by_run(episodes["run_id"], ended)},
        )


def _by_run(run_ids: pd.Series, columns: Iterable[pd.Series]) -> Iterable[tuple[str, list[np.ndarray]]]:
    arrays = [column.to_numpy() for column in columns]
    for run, rows in run_ids.groupby(run_ids, sort=False, observed=True).indices.items():
        yield str(run), [array[rows] for array in arrays]

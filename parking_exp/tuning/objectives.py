"""Objectives of a search: a number in 0 ... 1 for each run of a trial, the higher the better."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from parking_exp.config.schema import RunConfig
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import read_metrics
from parking_exp.statistics.curves import normalised_area
from parking_exp.tuning.search_config import Objective


@dataclass(frozen=True)
class RunCurve:
    """Success of one run at each of its evaluations so far; of a finished run, the final one is the last.

    Attributes:
        steps: env steps, rising.
        success: success rates.
        final: metrics at the end of the run; empty before that.
    """

    steps: Sequence[int]
    success: Sequence[float]
    final: Mapping[str, float]

    @property
    def area(self) -> float:
        """Normalised area under the curve."""
        return normalised_area(self.steps, self.success)


def read_curve(directory: RunDirectory) -> RunCurve:
    """Read the evaluations of a run from its directory.

    Raises:
        DamagedFileError: its log is damaged.
    """
    found: dict[int, float] = {}
    for record in read_metrics(directory.path / "metrics.jsonl"):
        if (rate := record["metrics"].get("eval/success_rate")) is not None:
            found[record["step"]] = rate
    result = directory.result()
    if result is not None and "final/success_rate" in result.metrics:
        found[result.steps] = result.metrics["final/success_rate"]
    steps = sorted(found)
    return RunCurve(steps, [found[step] for step in steps], result.metrics if result else {})


def evaluations(config: RunConfig) -> int:
    """Return how many evaluations a run has at most, the final one included."""
    every = config.evaluation.every_n_steps
    return config.total_timesteps // every + 2 if every else 1


def updates_at(config: RunConfig, step: int) -> float:
    """Return how many gradient updates a run has made at an env step."""
    starts = config.algorithm.arguments.get("learning_starts", 0)
    train_freq, gradient_steps = config.update_rounds()
    if isinstance(train_freq, tuple) or gradient_steps < 0:  # by episodes, with as many updates as steps
        return max(0.0, step - starts)
    return max(0.0, step - starts) * gradient_steps / (train_freq * config.n_envs)


def run_value(objective: Objective, curve: RunCurve) -> float:
    """Return an objective of one finished run."""
    match objective:
        case "success_auc":
            return curve.area
        case "final_success":
            return curve.final["final/success_rate"]
        case "final_parked":
            return curve.final["final/parked_rate"]


def partial_value(finished: Sequence[float], curve: RunCurve, share: float) -> float:
    """Return the mean area so far, which pruning compares.

    Args:
        finished: areas of the trial's finished runs.
        curve: of the current run, with at least one evaluation.
        share: fraction of the current run that is over, which weights its area.
    """
    return (sum(finished) + share * curve.area) / (len(finished) + share)

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

    def value(self, objective: Objective) -> float:
        """Return an objective of the finished run; `success_auc` also of an unfinished one."""
        if objective == "success_auc":
            return normalised_area(self.steps, self.success)
        return self.final[{"final_success": "final/success_rate", "final_parked": "final/parked_rate"}[objective]]


def read_curve(directory: RunDirectory) -> RunCurve:
    """Read the evaluations of a run from its directory.

    Raises:
        DamagedFileError: its log is damaged.
    """
    rates: dict[int, float] = {}
    for record in read_metrics(directory.path / "metrics.jsonl"):
        if (rate := record["metrics"].get("eval/success_rate")) is not None:
            rates[record["step"]] = rate
    result = directory.result()
    if result is not None and "final/success_rate" in result.metrics:
        rates[result.steps] = result.metrics["final/success_rate"]
    steps = sorted(rates)
    return RunCurve(steps, [rates[step] for step in steps], result.metrics if result else {})


def values_so_far(finished: Sequence[float], curve: RunCurve, total_timesteps: int) -> list[float]:
    """Return the mean area of a trial's runs at each evaluation of its current run, which pruning compares.

    The current run's area is weighted by the fraction of the run that is over.

    Args:
        finished: areas of the trial's finished runs.
        curve: of the current run.
        total_timesteps: of the current run.
    """
    values = []
    for position, step in enumerate(curve.steps, 1):
        weight = min(1.0, step / total_timesteps)
        area = normalised_area(curve.steps[:position], curve.success[:position])
        values.append((sum(finished) + weight * area) / (len(finished) + weight) if finished or weight else area)
    return values


def updates_at(config: RunConfig, step: int) -> float:
    """Return how many gradient updates a run has made at an env step."""
    steps = max(0.0, step - config.algorithm.arguments.get("learning_starts", 0))
    train_freq, gradient_steps = config.update_rounds()
    if isinstance(train_freq, tuple) or gradient_steps < 0:  # by episodes, with as many updates as steps
        return steps
    return steps * gradient_steps / (train_freq * config.n_envs)

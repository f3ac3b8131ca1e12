"""Objectives of a search: a number for each run of a trial, and their mean over its seeds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from parking_exp.config.schema import RunConfig
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import read_metrics
from parking_exp.statistics.curves import normalised_area
from parking_exp.statistics.survival import steps_to
from parking_exp.tuning.schema import Objective

THRESHOLD, HOLD = 0.95, 3
# A run that never holds 95 % costs more than any that does [CPU-seconds]: more than a day on one core.
CENSORED_S = 1e5


@dataclass(frozen=True)
class UnitCosts:
    """CPU-seconds of one gradient update and of one env step, policy and replay buffer included."""

    update_s: float
    step_s: float


@dataclass(frozen=True)
class RunCurve:
    """Success of one run at each of its evaluations so far; of a finished run, the final one is the last.

    Attributes:
        steps: env steps, rising.
        success: success rates.
        final: metrics of the run's end; none before that.
    """

    steps: Sequence[int]
    success: Sequence[float]
    final: Mapping[str, float]


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


def cost_at(config: RunConfig, step: float, units: UnitCosts) -> float:
    """Return the cost of a run up to an env step [CPU-seconds of the core where the unit costs were measured]."""
    return updates_at(config, round(step)) * units.update_s + step * units.step_s


def run_value(objective: Objective, config: RunConfig, curve: RunCurve, units: UnitCosts | None) -> float:
    """Return an objective of one finished run.

    A run that never holds 95 % has a `cost_to_95` above all that do, the higher the lower its success.
    """
    match objective:
        case "success_auc":
            return normalised_area(curve.steps, curve.success)
        case "final_success":
            return curve.final["final/success_rate"]
        case "final_parked":
            return curve.final["final/parked_rate"]
    assert units is not None
    step, reached = steps_to(curve.steps, curve.success, THRESHOLD, HOLD)
    if reached:
        return cost_at(config, step, units)
    whole = cost_at(config, curve.steps[-1], units)
    return CENSORED_S + whole * (2 - normalised_area(curve.steps, curve.success))


def partial_value(objective: Objective, finished: Sequence[float], curve: RunCurve, share: float) -> float:
    """Return what pruning compares while a trial is under way: its mean area so far, lower being better for a cost.

    Args:
        objective: of the search.
        finished: areas of the trial's finished runs.
        curve: of the run under way, with at least one evaluation.
        share: of the run under way that is over; it counts as much of a finished one.
    """
    area = (sum(finished) + share * normalised_area(curve.steps, curve.success)) / (len(finished) + share)
    return 1 - area if objective == "cost_to_95" else area


def describe(objective: str, value: float, n_seeds: int) -> str:
    """Write an objective's value, mean over seeds, for people."""
    if objective != "cost_to_95":
        return f"{value:.1%}"
    missed = round(value * n_seeds / CENSORED_S) if value >= CENSORED_S / n_seeds else 0
    return f"{value:.1f} CPU-s" if not missed else f"{missed} of {n_seeds} seeds never hold 95 %"

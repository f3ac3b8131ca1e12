"""Objectives of a search: a number in 0 ... 1 for each run of a trial, the higher the better."""

from collections.abc import Sequence

from parking_exp.config.schema import RunConfig
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import read_metrics
from parking_exp.statistics import normalised_area
from parking_exp.tuning.search_config import Objective

FINAL_METRICS = {"final_success": "final/success_rate", "final_parked": "final/parked_rate"}


def success_curve(directory: RunDirectory) -> tuple[list[int], list[float]]:
    """Return the env steps of a run's evaluations so far, and their success rates; the last may be the final one."""
    records = read_metrics(directory.path / "metrics.jsonl")
    name = "eval/success_rate"
    rates = {record["step"]: record["metrics"][name] for record in records if name in record["metrics"]}
    result = directory.result()
    if result is not None and "final/success_rate" in result.metrics:
        rates[result.steps] = result.metrics["final/success_rate"]
    steps = sorted(rates)
    return steps, [rates[step] for step in steps]


def objective_value(directory: RunDirectory, objective: Objective) -> float:
    """Return an objective of a finished run."""
    result = directory.result()
    if result is not None and objective in FINAL_METRICS:
        return result.metrics[FINAL_METRICS[objective]]
    return normalised_area(*success_curve(directory))


def values_so_far(
    finished: Sequence[float], steps: Sequence[int], success: Sequence[float], total_timesteps: int
) -> list[float]:
    """Return the mean area of a trial's runs at each evaluation of its current run, which pruning compares.

    The current run's area is weighted by the fraction of the run that is over; `finished` are the areas of the others.
    """
    values = []
    for position, step in enumerate(steps, 1):
        weight = min(1.0, step / total_timesteps)
        area = normalised_area(steps[:position], success[:position])
        values.append((sum(finished) + weight * area) / (len(finished) + weight) if finished or weight else area)
    return values


def updates_at(config: RunConfig, step: int) -> float:
    """Return how many gradient updates a run has made at an env step."""
    steps = max(0.0, step - config.algorithm.arguments.get("learning_starts", 0))
    train_freq, gradient_steps = config.update_rounds()
    if isinstance(train_freq, tuple) or gradient_steps < 0:  # by episodes, with as many updates as steps
        return steps
    return steps * gradient_steps / (train_freq * config.n_envs)

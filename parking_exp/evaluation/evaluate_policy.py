"""Evaluate a policy on episodes with fixed seeds, one row per episode, and summarise them in
numbers and sentences.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.statistics import wilson_interval
from parking_exp.tasks.finite import check_finite
from parking_exp.tasks.metrics import EPISODE_SEED, Episode, Metric, episode_columns, outcome
from parking_exp.tasks.task import EvaluationBatch, Policy, Task

TOLERANCE = 1e-9  # of numbers, between two simulators
Metrics = Sequence[Metric]


def evaluate(
    policy: Policy,
    task: Task,
    seeds: Sequence[int],
    on_step: Callable[[int], None] | None = None,
    simulator: str | None = None,
) -> pd.DataFrame:
    """Run one episode from each seed and return one row per episode, in the order of `seeds`.

    The policy sees the episodes in batches, without those that are finished: the same batches in
    every simulator.

    Args:
        policy, task: what is evaluated, and on what.
        seeds: of `env.reset`.
        on_step: called after each step of a batch with the number of finished episodes; may raise
            to stop.
        simulator: one of the config's `simulators`; None: its `simulator`.

    Raises:
        DivergenceError: an observation or a reward is not finite.
    """
    rows: list[dict[str, Any]] = []
    for first in range(0, len(seeds), task.batch_size):
        batch_seeds = seeds[first : first + task.batch_size]
        batch = task.evaluation_batch([*batch_seeds], simulator or task.config.simulator)
        _run_batch(policy, task, batch, np.asarray(batch_seeds), rows, on_step)
    order = {seed: number for number, seed in enumerate(seeds)}
    rows.sort(key=lambda row: order[row[EPISODE_SEED]])
    return pd.DataFrame(rows, columns=episode_columns(task.metrics))


def find_differences(episodes: pd.DataFrame, reference: pd.DataFrame) -> list[str]:
    """Compare two tables of the same episodes, row by row; return a phrase for each that
    differs.
    """
    phrases = []
    for ours, theirs in zip(episodes.to_dict("records"), reference.to_dict("records"), strict=True):
        columns = [name for name in ours if not _is_same(ours[name], theirs[name])]
        if columns:
            values = ", ".join(f"{name} {ours[name]} and {theirs[name]}" for name in columns)
            phrases.append(f"{EPISODE_SEED} {ours[EPISODE_SEED]}: {values}")
    return phrases


def summarise(episodes: pd.DataFrame, metrics: Metrics) -> dict[str, float]:
    """Return the rate or mean of every metric over an episodes table: success_rate, ...,
    return_mean.
    """
    return {metric.key: float(metric.values(episodes).mean()) for metric in metrics}


def rank(summary: dict[str, float], task: Task) -> tuple[float, ...]:
    """Return the sort key of an evaluation: success rate, then fewer failures, then fewer steps.
    Larger is better.
    """
    return summary["success_rate"], -summary[f"{task.failure}_rate"], -summary["steps_mean"]


def intervals(episodes: pd.DataFrame, metrics: Metrics) -> dict[str, tuple[float, float]]:
    """Return the Wilson 95 % interval of each rate, e.g. of success_rate."""
    return {
        rate.key: wilson_interval(int(rate.values(episodes).sum()), len(episodes))
        for rate in _rates(metrics)
    }


def describe(episodes: pd.DataFrame, metrics: Metrics) -> str:
    """Return rates with Wilson 95 % intervals, and means of the rest, as lines of text."""
    n, summary, lines = len(episodes), summarise(episodes, metrics), []
    for rate, (low, high) in zip(
        _rates(metrics), intervals(episodes, metrics).values(), strict=True
    ):
        value, note = summary[rate.key], f"  ({rate.note})" if rate.note else ""
        count = f"{value * n:.0f} of {n}"
        lines.append(
            f"{rate.name:<8}{value:7.1%}   95 % interval {low:.1%} to {high:.1%}   {count}{note}"
        )
    means = [metric for metric in metrics if not metric.is_rate]
    texts = [f"{mean.label.lower()} {summary[mean.key]:.3g} {mean.unit}".rstrip() for mean in means]
    return "\n".join([*lines, f"mean     {', '.join(texts)}"])


def describe_rates(summary: dict[str, float], step: int, metrics: Metrics) -> str:
    """Return one line about an evaluation during training."""
    return (
        f"evaluation at step {step}: "
        f"{', '.join(f'{rate.name} {summary[rate.key]:.0%}' for rate in _rates(metrics))}"
    )


def _rates(metrics: Metrics) -> list[Metric]:
    return [metric for metric in metrics if metric.is_rate]


def _run_batch(
    policy: Policy,
    task: Task,
    batch: EvaluationBatch,
    seeds: np.ndarray,
    rows: list[dict[str, Any]],
    on_step: Callable[[int], None] | None,
) -> None:
    """Step a batch until all episodes have ended; append the row of each when it ends."""
    observation, steps, totals = batch.observe(), 0, np.zeros(len(seeds))
    while len(batch):
        step = batch.step(policy(observation))
        steps += 1
        check_finite({**step.observation, "reward": step.reward}, f"in step {steps} of an episode")
        totals += step.reward
        done = step.terminated | step.truncated
        for index in np.flatnonzero(done).tolist():
            ending = outcome(task.failure, bool(step.failed[index]), bool(step.is_success[index]))
            episode = Episode(ending, steps, float(totals[index]), batch.ending(index))
            values = {metric.name: metric.of(episode) for metric in task.metrics}
            rows.append({EPISODE_SEED: int(seeds[index]), "outcome": ending, **values})
        observation = step.observation
        if done.any():
            batch.keep(~done)
            seeds, totals = seeds[~done], totals[~done]
            observation = {key: value[~done] for key, value in observation.items()}
        if on_step is not None:
            on_step(len(rows))


def _is_same(value: Any, other: Any) -> bool:
    return abs(value - other) <= TOLERANCE if isinstance(value, float) else value == other

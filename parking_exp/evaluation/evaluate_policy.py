"""Evaluate a policy on episodes with fixed seeds, and summarise them."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.evaluation.path_recorder import PathRecorder
from parking_exp.statistics import wilson_interval
from parking_exp.tasks.finite import check_finite
from parking_exp.tasks.metrics import EPISODE_SEED, Episode, Metric, episode_columns, outcome
from parking_exp.tasks.rollout import rollout, seed_batches
from parking_exp.tasks.task import EvaluationBatch, Policy, Task

TOLERANCE = 1e-9  # difference of numbers between two simulators
Metrics = Sequence[Metric]


def evaluate_policy(
    policy: Policy,
    task: Task,
    seeds: Sequence[int],
    on_progress: Callable[[int], None] | None = None,
    simulator: str | None = None,
    path_recorder: PathRecorder | None = None,
) -> pd.DataFrame:
    """Run one episode from each seed and return one row per episode, in the order of `seeds`.

    The policy sees the unfinished episodes of a batch. The batches are the same in every simulator.

    Args:
        policy: the policy that is evaluated.
        task: the task on which it is evaluated.
        seeds: seeds of `env.reset`, each at most once.
        on_progress: called after each step of a batch, and while a scripted policy prepares for
            one, with the number of finished episodes; may raise to stop.
        simulator: one of the config's `simulators`; None: its `simulator`.
        path_recorder: records where the episodes are at each step.

    Raises:
        DivergenceError: an observation or a reward is not finite.
    """
    rows: dict[int, dict[str, Any]] = {}
    for batch_seeds in seed_batches(seeds, task, policy):
        batch = task.evaluation_batch(batch_seeds, simulator)
        _run_batch(policy, task, batch, np.asarray(batch_seeds), rows, on_progress, path_recorder)

    in_order = [rows[seed] for seed in seeds]
    return pd.DataFrame(in_order, columns=episode_columns(task.metrics))


def find_differences(episodes: pd.DataFrame, reference: pd.DataFrame) -> list[str]:
    """Compare two tables of the same episodes and return a phrase for each that differs."""
    phrases = []
    for ours, theirs in zip(episodes.to_dict("records"), reference.to_dict("records"), strict=True):
        values = [
            f"{name} {ours[name]} and {theirs[name]}"
            for name in ours
            if not _is_same(ours[name], theirs[name])
        ]
        if values:
            phrases.append(f"{EPISODE_SEED} {ours[EPISODE_SEED]}: {', '.join(values)}")
    return phrases


def summarise(episodes: pd.DataFrame, metrics: Metrics) -> dict[str, float]:
    """Return the rate or mean of every metric: success_rate, ..., return_mean.

    A metric that no episode has is left out, such as the time to success if no episode succeeds.
    """
    means = {metric.key: float(metric.values(episodes).mean()) for metric in metrics}
    return {key: mean for key, mean in means.items() if not math.isnan(mean)}


def rank_evaluation(summary: dict[str, float], task: Task) -> list[float]:
    """Return the sort key of an evaluation, which is larger for a better one.

    It compares the success rate, then failures, then steps.
    """
    return [summary["success_rate"], -summary[f"{task.failure}_rate"], -summary["steps_mean"]]


def rate_intervals(episodes: pd.DataFrame, metrics: Metrics) -> dict[str, tuple[float, float]]:
    """Return the Wilson 95 % interval of each rate, e.g. of success_rate."""
    bounds = {}
    for rate in _rates(metrics):
        n_true = int(rate.values(episodes).sum())
        bounds[rate.key] = wilson_interval(n_true, len(episodes))
    return bounds


def describe_episodes(episodes: pd.DataFrame, metrics: Metrics) -> list[str]:
    """Return lines of text: each rate with its interval, then the means of the other metrics."""
    summary = summarise(episodes, metrics)
    bounds = rate_intervals(episodes, metrics)
    lines = []
    means = []
    for metric in metrics:
        if metric.key not in summary:
            continue
        value = summary[metric.key]
        if metric.is_rate:
            low, high = bounds[metric.key]
            count = f"{value * len(episodes):.0f} of {len(episodes)}"
            line = f"{metric.name:<8}{value:7.1%}   95 % interval {low:.1%} to {high:.1%}   {count}"
            if metric.note:
                line += f"  ({metric.note})"
            lines.append(line)
        else:
            means.append(f"{metric.label.lower()} {value:.3g} {metric.unit}".rstrip())
    lines.append(f"mean     {', '.join(means)}")
    return lines


def describe_rates(summary: dict[str, float], step: int, metrics: Metrics) -> str:
    """Return one line about an evaluation during training."""
    rates = [f"{rate.name} {summary[rate.key]:.0%}" for rate in _rates(metrics)]
    return f"evaluation at step {step}: {', '.join(rates)}"


def _rates(metrics: Metrics) -> list[Metric]:
    return [metric for metric in metrics if metric.is_rate]


def _run_batch(
    policy: Policy,
    task: Task,
    batch: EvaluationBatch,
    seeds: np.ndarray,
    rows: dict[int, dict[str, Any]],
    on_progress: Callable[[int], None] | None,
    path_recorder: PathRecorder | None,
) -> None:
    """Step a batch until all episodes have ended, and add the row of each to `rows` by its seed."""
    returns = np.zeros(len(seeds))
    if path_recorder is not None:
        path_recorder.record(batch.observe(), seeds, 0)
    while_preparing = None if on_progress is None else partial(on_progress, len(rows))
    batch_steps = rollout(policy, batch, seeds.tolist(), while_preparing)
    for steps, (episodes, _, step) in enumerate(batch_steps, start=1):
        check_finite({**step.observation, "reward": step.reward}, f"in step {steps} of an episode")
        returns[episodes] += step.reward
        if path_recorder is not None:
            path_recorder.record(step.observation, seeds[episodes], steps)

        for index in np.flatnonzero(step.terminated | step.truncated).tolist():
            number = episodes[index]
            seed = int(seeds[number])
            total_reward = float(returns[number])
            is_success = bool(step.is_success[index])
            info = {"is_success": is_success, **batch.info(index), **policy.info(index)}
            ending = outcome(task.failure, bool(step.failed[index]), is_success)
            episode = Episode(ending, steps, total_reward, batch.ending(index), info)
            values = {metric.name: metric.of(episode) for metric in task.metrics}
            rows[seed] = {EPISODE_SEED: seed, "outcome": ending, **values}

        if on_progress is not None:
            on_progress(len(rows))


def _is_same(value: Any, other: Any) -> bool:
    if isinstance(value, float):
        return bool(np.isclose(value, other, rtol=0, atol=TOLERANCE, equal_nan=True))
    return value == other

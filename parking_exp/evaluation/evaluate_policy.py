"""Evaluate a policy on scenes, one row per episode, and summarise episodes in numbers and sentences.

Scene s is what `env.reset(seed=s)` of highway-env makes.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.config.schema import EnvConfig, Simulation
from parking_exp.envs.highway import HighwayBatch
from parking_exp.envs.interface import Policy
from parking_exp.envs.outcomes import outcome
from parking_exp.envs.scenes import Scenes
from parking_exp.envs.simulator import Simulator
from parking_exp.evaluation.metrics import CAR_COLUMNS, EPISODE_COLUMNS, METRICS, RANKING, Episode
from parking_exp.runs.atomic_files import replacing
from parking_exp.statistics import wilson_interval

BATCH_SIZE = 250  # scenes that are stepped together; more are no faster, and a signal is noticed between two steps
TOLERANCE = 1e-9  # of numbers, between two simulators
RATES = [metric for metric in METRICS if metric.is_rate]
SceneBatch = HighwayBatch | Simulator


class Recorder:
    """Collects the trajectories of the cars of many scenes, which are stepped together."""

    def __init__(self) -> None:
        self._scenes: list[np.ndarray] = []
        self._cars: list[np.ndarray] = []

    def add(self, scenes: np.ndarray, cars: np.ndarray) -> None:
        """Add the start, or a step, of unfinished scenes: their numbers, shape (n,), and CAR_COLUMNS, shape (n, 4)."""
        self._scenes.append(scenes.copy())
        self._cars.append(cars.astype(np.float32))

    def save(self, path: Path) -> None:
        """Write an npz file: `scene`, sorted, and `length`, shape (n,), and CAR_COLUMNS of all scenes in turn."""
        rows, cars = np.concatenate(self._scenes), np.concatenate(self._cars)
        order = np.argsort(rows, kind="stable")  # rows of a scene stay in the order of time
        scene, length = np.unique(rows, return_counts=True)
        columns = dict(zip(CAR_COLUMNS, cars[order].T, strict=True))
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, scene=scene, length=length, **columns)


def evaluate(
    policy: Policy,
    env: EnvConfig,
    scenes: Sequence[int],
    on_step: Callable[[int], None] | None = None,
    simulator: Simulation | None = None,
    recorder: Recorder | None = None,
) -> pd.DataFrame:
    """Run one episode in each scene and return one row per episode, in the order of `scenes`.

    The policy sees the scenes in batches, without those that are finished: the same batches in either simulator.

    Args:
        policy, env, scenes: what is evaluated, and where; scenes are seeds of `env.reset`.
        on_step: called after each step of a batch with the number of finished episodes; may raise to stop.
        simulator: what simulates the scenes; None: the env's own.
        recorder: is given the cars of all scenes at the start and after each step.
    """
    rows: list[dict[str, Any]] = []
    for first in range(0, len(scenes), BATCH_SIZE):
        seeds = np.asarray(scenes[first : first + BATCH_SIZE])
        if (simulator or env.simulator) == "highway_env":
            batch: SceneBatch = HighwayBatch(env, seeds.tolist())
        else:
            batch = Simulator(env, Scenes.from_seeds(seeds.tolist(), env.vehicles_count))
        _run_batch(policy, batch, seeds, rows, on_step, recorder)
    order = {scene: number for number, scene in enumerate(scenes)}
    rows.sort(key=lambda row: order[row["scene"]])
    return pd.DataFrame(rows, columns=EPISODE_COLUMNS)


def differences(episodes: pd.DataFrame, certified: pd.DataFrame) -> list[str]:
    """Compare two tables of the same scenes, episode by episode; return a phrase for each scene that differs."""
    phrases = []
    for ours, theirs in zip(episodes.to_dict("records"), certified.to_dict("records"), strict=True):
        columns = [name for name in EPISODE_COLUMNS if not _is_same(ours[name], theirs[name])]
        if columns:
            values = ", ".join(f"{name} {ours[name]} and {theirs[name]}" for name in columns)
            phrases.append(f"scene {ours['scene']}: {values}")
    return phrases


def summarise(episodes: pd.DataFrame) -> dict[str, float]:
    """Return the rate or mean of every metric over an episodes table: success_rate, ..., speed_mps_mean."""
    return {metric.key: float(metric.values(episodes).mean()) for metric in METRICS}


def rank(summary: dict[str, float]) -> tuple[float, ...]:
    """Return the sort key of an evaluation: success rate, then fewer crashes, then fewer steps. Larger is better."""
    metrics = {metric.name: metric for metric in METRICS}
    ranked = [metrics[name] for name in RANKING]
    return tuple(summary[metric.key] if metric.higher_is_better else -summary[metric.key] for metric in ranked)


def intervals(episodes: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Return the Wilson 95 % interval of each rate: of success_rate, crash_rate, timeout_rate and parked_rate."""
    return {rate.key: wilson_interval(int(rate.values(episodes).sum()), len(episodes)) for rate in RATES}


def describe(episodes: pd.DataFrame) -> str:
    """Return rates with Wilson 95 % intervals, and means of the rest, as lines of text."""
    n, summary, lines = len(episodes), summarise(episodes), []
    for rate, (low, high) in zip(RATES, intervals(episodes).values(), strict=True):
        value = summary[rate.key]
        note = "  (strict: inside the lines, within 10 degrees, stationary)" if rate.name == "parked" else ""
        count = f"{value * n:.0f} of {n}"
        lines.append(f"{rate.name:<8}{value:7.1%}   95 % interval {low:.1%} to {high:.1%}   {count}{note}")
    means = [metric for metric in METRICS if not metric.is_rate]
    texts = [f"{mean.label.lower()} {summary[mean.key]:.3g} {mean.unit}".rstrip() for mean in means]
    return "\n".join([*lines, f"mean     {', '.join(texts)}"])


def success_line(summary: dict[str, float], step: int) -> str:
    """Return one line about an evaluation during training."""
    return f"evaluation at step {step}: {', '.join(f'{rate.name} {summary[rate.key]:.0%}' for rate in RATES)}"


def _run_batch(
    policy: Policy,
    batch: SceneBatch,
    scenes: np.ndarray,
    rows: list[dict[str, Any]],
    on_step: Callable[[int], None] | None,
    recorder: Recorder | None,
) -> None:
    """Step a batch until all episodes have ended; append the row of each when it ends."""
    observation, steps, totals = batch.observe(), 0, np.zeros(len(scenes))
    if recorder is not None:
        recorder.add(scenes, batch.cars())
    while len(batch):
        step = batch.step(policy(observation))
        if recorder is not None:
            recorder.add(scenes, batch.cars())
        steps += 1
        totals += step.reward
        done = step.terminated | step.truncated
        for index in np.flatnonzero(done).tolist():
            ending = outcome(bool(step.crashed[index]), bool(step.is_success[index]))
            episode = Episode(ending, steps, float(totals[index]), batch.pose(index))
            values = {metric.name: metric.of(episode) for metric in METRICS}
            rows.append({"scene": int(scenes[index]), "outcome": ending, **values})
        observation = step.observation
        if done.any():
            batch.keep(~done)
            scenes, totals = scenes[~done], totals[~done]
            observation = {key: value[~done] for key, value in observation.items()}
        if on_step is not None:
            on_step(len(rows))


def _is_same(value: Any, other: Any) -> bool:
    return abs(value - other) <= TOLERANCE if isinstance(value, float) else value == other

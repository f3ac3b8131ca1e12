"""Evaluate a policy on scenes and return one row per episode.

Scene s is what `env.reset(seed=s)` of highway-env makes.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from parking_exp.config.schema import EnvConfig, Simulation
from parking_exp.envs.interface import Observation, Policy, SceneBatch
from parking_exp.envs.outcomes import outcome
from parking_exp.envs.scene_batches import start_scenes
from parking_exp.evaluation.metrics import EPISODE_COLUMNS, METRICS, RANKING, Episode
from parking_exp.evaluation.trajectories import Recorder

SIDE_BY_SIDE = 250  # scenes that are stepped together; more are no faster, and between two steps one can stop
TOLERANCE = 1e-9  # of continuous columns, between two simulators


def evaluate(
    policy: Policy,
    env: EnvConfig,
    scenes: Sequence[int],
    on_step: Callable[[int], None] | None = None,
    simulator: Simulation | None = None,
    recorder: Recorder | None = None,
) -> pd.DataFrame:
    """Run one episode in each scene and return one row per episode, in the order of `scenes`.

    The policy sees all scenes at once; finished ones are dropped. Whatever simulates them, it sees the same batches.

    Args:
        policy: what is evaluated.
        env: the `env` group; episodes last its `duration`.
        scenes: seeds of `env.reset`.
        on_step: called after each step of all episodes with the number that have finished; may raise to stop.
        simulator: what simulates the scenes; None: the env's own.
        recorder: is given the cars of all scenes at the start and after each step.

    Returns:
        Frame with the columns `metrics.EPISODE_COLUMNS`.
    """
    rows: list[dict[str, Any]] = []
    for first in range(0, len(scenes), SIDE_BY_SIDE):
        chunk = scenes[first : first + SIDE_BY_SIDE]
        batch = start_scenes(env, chunk, simulator)
        try:
            for row in _episodes(policy, batch, np.asarray(chunk), on_step, recorder, finished=first):
                rows.append(row)
        finally:
            batch.close()
    order = {scene: number for number, scene in enumerate(scenes)}
    rows.sort(key=lambda row: order[row["scene"]])
    return pd.DataFrame(rows, columns=EPISODE_COLUMNS)


def differences(episodes: pd.DataFrame, certified: pd.DataFrame) -> list[str]:
    """Compare two tables of the same scenes, episode by episode; return a phrase for each scene that differs."""
    found = []
    pairs = zip(episodes.to_dict("records"), certified.to_dict("records"), strict=True)
    for ours, theirs in pairs:
        columns = [name for name in EPISODE_COLUMNS if not _same(ours[name], theirs[name])]
        if columns:
            values = ", ".join(f"{name} {ours[name]} and {theirs[name]}" for name in columns)
            found.append(f"scene {ours['scene']}: {values}")
    return found


def summarise(episodes: pd.DataFrame) -> dict[str, float]:
    """Return the rate or mean of every metric over an episodes table: success_rate, ..., speed_mps_mean."""
    return {metric.key: float(metric.values(episodes).mean()) for metric in METRICS}


def rank(summary: dict[str, float]) -> tuple[float, ...]:
    """Return the sort key of an evaluation: success rate, then fewer crashes, then fewer steps. Larger is better."""
    ranked = [next(metric for metric in METRICS if metric.name == name) for name in RANKING]
    return tuple(summary[metric.key] if metric.higher_is_better else -summary[metric.key] for metric in ranked)


def rollout(policy: Policy, env: gym.Env, scene: int) -> Iterator[tuple[Observation, dict[str, Any], bool]]:
    """Yield (observation, info, done) of one episode, the start included."""
    observation, info = env.reset(seed=scene)
    done = False
    yield observation, info, done
    while not done:
        action = policy(_stack([observation]))[0]
        observation, _, terminated, truncated, info = env.step(action)
        done = terminated or truncated
        yield observation, info, done


def _episodes(
    policy: Policy,
    batch: SceneBatch,
    scenes: np.ndarray,
    on_step: Callable[[int], None] | None,
    recorder: Recorder | None,
    finished: int,
) -> Iterator[dict[str, Any]]:
    """Yield the row of each episode when it has ended."""
    observation, steps = batch.observe(), 0
    totals = np.zeros(len(scenes))
    if recorder is not None:
        recorder.add(scenes, batch.cars())
    while len(batch):
        step = batch.step(policy(observation))
        if recorder is not None:
            recorder.add(scenes, batch.cars())
        steps += 1
        totals += step.reward
        done = step.terminated | step.truncated
        for row in np.flatnonzero(done):
            ending = outcome(bool(step.crashed[row]), bool(step.is_success[row]))
            episode = Episode(ending, steps, float(totals[row]), batch.pose(int(row)))
            values: dict[str, Any] = {metric.name: metric.of(episode) for metric in METRICS}
            values |= {"scene": int(scenes[row]), "outcome": ending}
            yield {name: values[name] for name in EPISODE_COLUMNS}
        observation = step.observation
        if done.any():
            finished += int(done.sum())
            batch.keep(~done)
            scenes, totals = scenes[~done], totals[~done]
            observation = {key: value[~done] for key, value in observation.items()}
        if on_step is not None:
            on_step(finished)


def _same(ours: Any, theirs: Any) -> bool:
    return abs(ours - theirs) <= TOLERANCE if isinstance(ours, float) else ours == theirs


def _stack(observations: list[Observation]) -> Observation:
    return {key: np.stack([observation[key] for observation in observations]) for key in observations[0]}

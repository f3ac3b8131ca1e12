"""Policy and scenes in, a table of episodes out. Scene s is what `env.reset(seed=s)` of highway-env makes."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from parking_exp.config import EnvConfig
from parking_exp.envs import make_env
from parking_exp.outcomes import outcome, pose
from parking_exp.policy import Observation, Policy

EPISODE_COLUMNS = ["scene", "outcome", "parked", "steps", "return", "distance_m", "heading_error_rad", "speed_mps"]
PARALLEL_EPISODES = 32


def evaluate(
    policy: Policy, env: EnvConfig, scenes: Sequence[int], on_step: Callable[[int], None] | None = None
) -> pd.DataFrame:
    """Run one episode in each scene and return one row per episode, in the order of `scenes`.

    Episodes run side by side, so that the policy sees batches; a finished one makes room for the next scene.

    Args:
        policy: what is evaluated.
        env: the `env` group; episodes last its `duration`.
        scenes: seeds of `env.reset`.
        on_step: called after each step of all episodes with the number that have finished; may raise to stop.

    Returns:
        Frame with the columns EPISODE_COLUMNS: `outcome` is success, crash or timeout; `parked` is the strict
        definition of `outcomes.Pose`; `return` is the undiscounted sum of rewards; `heading_error_rad` and
        `speed_mps` are absolute values at the end.
    """
    waiting = list(reversed(scenes))
    slots = [make_env(env) for _ in range(min(PARALLEL_EPISODES, len(scenes)))]
    running = [_Episode(slot, waiting.pop()) for slot in slots]
    rows: dict[int, dict[str, Any]] = {}
    try:
        while running:
            actions = policy(_stack([episode.observation for episode in running]))
            for episode, action in zip(running, actions, strict=True):
                episode.step(action)
            for episode in [e for e in running if e.row is not None]:
                assert episode.row is not None
                rows[episode.scene] = episode.row
                index = running.index(episode)
                running[index : index + 1] = [_Episode(episode.env, waiting.pop())] if waiting else []
            if on_step is not None:
                on_step(len(rows))
    finally:
        for slot in slots:
            slot.close()
    return pd.DataFrame([rows[scene] for scene in scenes], columns=EPISODE_COLUMNS)


def summarise(episodes: pd.DataFrame) -> dict[str, float]:
    """Return rates and means of an episodes table: success_rate, crash_rate, ..., speed_mps_mean."""
    rates = {f"{name}_rate": float((episodes["outcome"] == name).mean()) for name in ("success", "crash", "timeout")}
    rates["parked_rate"] = float(episodes["parked"].mean())
    means = ["return", "steps", "distance_m", "heading_error_rad", "speed_mps"]
    return rates | {f"{name}_mean": float(episodes[name].mean()) for name in means}


def rank(summary: dict[str, float]) -> tuple[float, float, float]:
    """Sort key of an evaluation: by success rate, then by fewer crashes, then by fewer steps. Larger is better."""
    return summary["success_rate"], -summary["crash_rate"], -summary["steps_mean"]


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


class _Episode:
    """One running episode; `row` is set when it has ended."""

    def __init__(self, env: gym.Env, scene: int) -> None:
        self.env, self.scene = env, scene
        self.observation, _ = env.reset(seed=scene)
        self.steps, self.total = 0, 0.0
        self.row: dict[str, Any] | None = None

    def step(self, action: np.ndarray) -> None:
        self.observation, reward, terminated, truncated, info = self.env.step(action)
        self.steps += 1
        self.total += float(reward)
        if terminated or truncated:
            end = pose(self.env)
            self.row = {
                "scene": self.scene,
                "outcome": outcome(info),
                "parked": end.parked,
                "steps": self.steps,
                "return": self.total,
                "distance_m": end.distance_m,
                "heading_error_rad": abs(end.heading_error_rad),
                "speed_mps": abs(end.speed_mps),
            }


def _stack(observations: list[Observation]) -> Observation:
    return {key: np.stack([observation[key] for observation in observations]) for key in observations[0]}

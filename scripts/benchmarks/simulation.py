"""Benchmark the simulator against highway-env, and the evaluation on many scenes."""

import time
from typing import Any

import numpy as np

from benchmarks.timing import interleave, seconds, spread
from parking_exp import compose
from parking_exp.algorithms.build_model import greedy_policy
from parking_exp.evaluation.agents import load_model
from parking_exp.evaluation.evaluate_policy import evaluate
from parking_exp.tasks.parking.highway import make_env
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.registry import make_task


def stepping(
    option: str,
    n_scenes: int,
    rounds: int,
    seconds_per_side: float,
    seen: int = 0,
    rays: int = 0,
) -> dict[str, Any]:
    """Compare steps per second with uniformly random actions; ended episodes are restarted.

    Args:
        option: of the group `env`.
        n_scenes: of our simulator; highway-env has one.
        rounds: number of measurements of each side.
        seconds_per_side: length of a measurement.
        seen: other vehicles in our observation; highway-env's has none.
        rays: distances in both observations.
    """
    overrides = [f"env={option}", f"env.observation.rays={rays}"]
    env: Any = compose(*overrides, f"env.observation.vehicles_count={seen}").env
    lot = lot_of(env)
    rng = np.random.default_rng(0)
    simulator = Simulator(env, lot.random(rng, n_scenes))
    unseen: Any = compose(*overrides, "env.observation.vehicles_count=0").env
    peer = make_env(unseen)
    actions = rng.uniform(-1, 1, (256, n_scenes, 2)).astype(np.float32)
    peer.reset(seed=0)

    def step_ours(step: int) -> None:
        ended = simulator.step(actions[step % 256])
        rows = np.flatnonzero(ended.terminated | ended.truncated)
        if len(rows):
            simulator.start(lot.random(rng, len(rows)), rows)

    def ours() -> float:
        steps, until = 0, time.perf_counter() + seconds_per_side
        while time.perf_counter() < until:
            step_ours(steps)
            steps += 1
        return steps * n_scenes

    def highway_env() -> float:
        steps, until = 0, time.perf_counter() + seconds_per_side
        while time.perf_counter() < until:
            *_, terminated, truncated, _ = peer.step(actions[steps % 256, steps % n_scenes])
            if terminated or truncated:
                peer.reset()
            steps += 1
        return steps

    for step in range(200):  # the first episodes start and crash together; let them spread out
        step_ours(step)
    return interleave(ours, highway_env, rounds) | {"peer": "highway-env", "unit": "env steps"}


def evaluation(n_scenes: int, rounds: int) -> dict[str, Any]:
    """Time the evaluation of the pretrained agent on many scenes."""
    policy, env = greedy_policy(load_model("pretrained")), compose().env
    times = [
        seconds(lambda: evaluate(policy, make_task(env), range(n_scenes)))
        for _ in range(rounds + 1)
    ]
    return spread(times[1:])

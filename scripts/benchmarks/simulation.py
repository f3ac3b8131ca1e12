"""Benchmark the simulator against highway-env and EnvPool, and the evaluation on many scenes."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.timing import Side, interleave, seconds, spread
from parking_exp import compose
from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.evaluation.agents import load_model
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.tasks.parking.highway import make_parking_env
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
        option: an option of the group `env`.
        n_scenes: the number of scenes in our simulator; highway-env has one.
        rounds: number of measurements of each side.
        seconds_per_side: length of a measurement.
        seen: other vehicles in our observation; highway-env's has none.
        rays: distances in both observations.
    """
    overrides = [f"env={option}", f"env.observation.rays={rays}"]
    env: Any = compose(*overrides, f"env.observation.vehicles_count={seen}").env
    unseen: Any = compose(*overrides, "env.observation.vehicles_count=0").env
    peer = make_parking_env(unseen)
    actions = _actions(1)
    peer.reset(seed=0)

    def step(number: int) -> None:
        *_, terminated, truncated, _ = peer.step(actions[number % len(actions), 0])
        if terminated or truncated:
            peer.reset()

    ours = _our_side(env, n_scenes, seconds_per_side)
    highway_env = _side(step, 1, seconds_per_side)
    return interleave(ours, highway_env, rounds) | {"peer": "highway-env", "unit": "env steps"}


def against_envpool(n_scenes: int, rounds: int, seconds_per_side: float) -> dict[str, Any]:
    """Compare steps per second with those of EnvPool's parking-v0 in one thread."""
    import envpool

    peer = envpool.make("parking-v0", env_type="gymnasium", num_envs=n_scenes, num_threads=1)
    actions = _actions(n_scenes)
    peer.reset()

    def step(number: int) -> None:
        peer.step(actions[number % len(actions)])  # starts ended episodes anew

    ours = _our_side(compose().env, n_scenes, seconds_per_side)
    theirs = _side(step, n_scenes, seconds_per_side)
    return interleave(ours, theirs, rounds) | {"peer": "EnvPool", "unit": "env steps"}


def _our_side(env: Any, n_scenes: int, seconds_per_side: float) -> Side:
    """Return a side that steps our simulator."""
    lot = lot_of(env)
    rng = np.random.default_rng(0)
    simulator = Simulator(env, lot.random(rng, n_scenes))
    actions = _actions(n_scenes)

    def step(number: int) -> None:
        ended = simulator.step(actions[number % len(actions)])
        rows = np.flatnonzero(ended.terminated | ended.truncated)
        if len(rows):
            simulator.start(lot.random(rng, len(rows)), rows)

    for number in range(200):  # the first episodes start and crash together; let them spread out
        step(number)
    return _side(step, n_scenes, seconds_per_side)


def _side(step: Callable[[int], None], n_scenes: int, seconds_per_side: float) -> Side:
    """Return a side that steps for some time; `step` gets the number of the step."""

    def side() -> float:
        number = 0
        until = time.perf_counter() + seconds_per_side
        while time.perf_counter() < until:
            step(number)
            number += 1
        return number * n_scenes

    return side


def _actions(n_scenes: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.uniform(-1, 1, (256, n_scenes, 2)).astype(np.float32)


def evaluation(n_scenes: int, rounds: int) -> dict[str, Any]:
    """Time the evaluation of the pretrained agent on many scenes."""
    policy = GreedyPolicy(load_model("pretrained"))
    env = compose().env
    times = [
        seconds(lambda: evaluate_policy(policy, make_task(env), range(n_scenes)))
        for _ in range(rounds + 1)
    ]
    return spread(times[1:])

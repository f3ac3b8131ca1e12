"""Benchmark the simulator against highway-env, and the evaluation on many scenes."""

import time
from typing import Any

import numpy as np

from benchmarks.timing import interleave, spread
from parking_exp.config.schema import EnvConfig
from parking_exp.envs.highway import make_env
from parking_exp.envs.interface import Policy
from parking_exp.envs.scenes import Scenes
from parking_exp.envs.simulator import Simulator
from parking_exp.evaluation.evaluate_policy import evaluate

PEER = "highway-env"


def stepping(env: EnvConfig, scenes: int, rounds: int, seconds: float) -> dict[str, Any]:
    """Compare steps per second with uniformly random actions; ended episodes are restarted."""
    rng = np.random.default_rng(0)
    simulator, peer = Simulator(env, Scenes.random(rng, scenes, env.vehicles_count)), make_env(env)
    actions = rng.uniform(-1, 1, (256, scenes, simulator.action_size)).astype(np.float32)
    peer.reset(seed=0)

    def ours() -> float:
        steps, until = 0, time.perf_counter() + seconds
        while time.perf_counter() < until:
            step = simulator.step(actions[steps % 256])
            ended = np.flatnonzero(step.terminated | step.truncated)
            if len(ended):
                simulator.start(Scenes.random(rng, len(ended), env.vehicles_count), ended)
            steps += 1
        return steps * scenes

    def theirs() -> float:
        steps, until = 0, time.perf_counter() + seconds
        while time.perf_counter() < until:
            *_, terminated, truncated, _ = peer.step(actions[steps % 256, steps % scenes])
            if terminated or truncated:
                peer.reset()
            steps += 1
        return steps

    # The first episodes start and crash together; let them spread out.
    for step in range(200):
        ended = simulator.step(actions[step])
        rows = np.flatnonzero(ended.terminated)
        simulator.start(Scenes.random(rng, len(rows), env.vehicles_count), rows)
    return interleave(ours, theirs, rounds) | {"peer": PEER, "unit": "env steps"}


def bulk_evaluation(policy: Policy, env: EnvConfig, scenes: int, rounds: int) -> dict[str, Any]:
    """Time the evaluation of a policy on many scenes."""
    times = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        table = evaluate(policy, env, range(scenes), simulator="vectorized")
        times.append(time.perf_counter() - start)
    return spread(times[1:], "wall_s") | {"success_rate": float((table["outcome"] == "success").mean())}

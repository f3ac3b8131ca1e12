"""Time single decisions of an agent and of the planner, on parallel slots."""

import statistics
import time
from pathlib import Path
from typing import Any

from benchmarks.timing import spread
from parking_exp import compose
from parking_exp.algorithms.scripted_policies import build_scripted_policy
from parking_exp.evaluation.agents import find_agent
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.task import Policy

DECISIONS = 50


def agent(rounds: int) -> dict[str, Any]:
    """Return the milliseconds in which `pretrained/parallel` decides."""
    found = find_agent("pretrained/parallel", Path("outputs"))
    env = found.config.env
    policy = found.policy(make_task(env))
    return spread([_decision_ms(policy, env, scene) for scene in range(rounds)])


def planner(rounds: int) -> dict[str, Any]:
    """Return the milliseconds in which the planner decides, once it has a plan."""
    config: Any = compose("env=parking_parallel", "env.level=hard", "algorithm=planner")
    algorithm = config.algorithm
    policy = build_scripted_policy(
        algorithm.target, algorithm.arguments, make_task(config.env), seed=0
    )
    values = []
    for scene in range(rounds):
        policy.start([scene])
        values.append(_decision_ms(policy, config.env, scene))
    return spread(values)


def _decision_ms(policy: Policy, env: Any, scene: int) -> float:
    """Return the median time of a decision while the car drives in a scene."""
    simulator = Simulator(env, lot_of(env).from_seeds([scene]))
    times_s = []

    for _ in range(DECISIONS):
        observation = simulator.observe()
        began = time.perf_counter()
        actions = policy(observation)
        times_s.append(time.perf_counter() - began)
        simulator.step(actions)
    return 1000 * statistics.median(times_s)

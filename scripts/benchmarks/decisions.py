"""Time single decisions of an agent and of the planner, on parallel slots."""

import statistics
import time
from pathlib import Path
from typing import Any

from benchmarks.timing import spread
from parking_exp import compose
from parking_exp.evaluation.agents import find_agent
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.scripted_policy import build_scripted_policy
from parking_exp.tasks.task import Policy


def agent_ms(rounds: int) -> dict[str, Any]:
    """Return the milliseconds in which `pretrained/parallel` decides."""
    agent = find_agent("pretrained/parallel", Path("outputs"))
    env = agent.config.env
    policy = agent.policy(make_task(env))
    return spread([_decision_ms(policy, env, scene) for scene in range(rounds)])


def planner_ms(rounds: int) -> dict[str, Any]:
    """Return the milliseconds in which the planner decides, once it has a plan."""
    config: Any = compose("env=parking_parallel", "env.level=extreme", "algorithm=planner")
    algorithm = config.algorithm
    policy = build_scripted_policy(
        algorithm.target, algorithm.arguments, make_task(config.env), seed=0
    )
    decisions_ms = []
    for scene in range(rounds):
        policy.start([scene])
        decisions_ms.append(_decision_ms(policy, config.env, scene))
    return spread(decisions_ms)


def _decision_ms(policy: Policy, env: Any, scene: int) -> float:
    """Return the median time of a decision in an episode."""
    simulator = Simulator(env, lot_of(env).from_seeds([scene]))
    observation = simulator.observe()
    times_s = []
    has_ended = False

    while not has_ended:
        began = time.perf_counter()
        actions = policy(observation)
        times_s.append(time.perf_counter() - began)
        step = simulator.step(actions)
        observation = step.observation
        has_ended = bool(step.terminated[0] | step.truncated[0])
    return 1000 * statistics.median(times_s)

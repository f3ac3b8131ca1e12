"""The figures of scripts/benchmark.py, with their targets."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from benchmarks import buffers, decisions, simulation, sweeps, training
from benchmarks.updates import updates

SHORT_RUN = (
    "n_envs=8",
    "updates_per_step=1",
    "algorithm.learning_starts=900",
    "total_timesteps=1200",
    "env.duration=4",
    "evaluation.every_n_steps=400",
    "evaluation.n_scenes=5",
    "evaluation.final_n_scenes=5",
    "evaluation.video_episodes=1",
)


class Figure(NamedTuple):
    """A figure: its target, `>= 3.0` or `<= 1.0`, and the function that measures it."""

    sign: str
    bound: float
    measure: Callable[[], dict[str, Any]]


def figures(rounds: int, all_cores: Sequence[int], *, quick: bool) -> dict[str, Figure]:
    """Return all figures; sweeps use all given cores, everything else runs on one."""
    step_s = 0.1 if quick else 0.5
    few = min(rounds, 1 if quick else 3)
    capacity = 200_000 if quick else 1_000_000
    samples = 20 if quick else 1000
    return {
        "simulator.n512.ratio": Figure(
            ">=", 3000, partial(simulation.stepping, "parking", 512, rounds, step_s)
        ),
        "simulator.n8.ratio": Figure(
            ">=", 250, partial(simulation.stepping, "parking", 8, rounds, step_s)
        ),
        "simulator.crowded.n512.ratio": Figure(
            ">=", 1500, partial(simulation.stepping, "parking_crowded", 512, rounds, step_s)
        ),
        "simulator.crowded.8_seen.n512.ratio": Figure(
            ">=", 2500, partial(simulation.stepping, "parking_crowded", 512, rounds, step_s, seen=8)
        ),
        "simulator.parallel.n512.ratio": Figure(
            ">=", 2000, partial(simulation.stepping, "parking_parallel", 512, rounds, step_s)
        ),
        "simulator.parallel.32_rays.n512.ratio": Figure(
            ">=",
            1000,
            partial(simulation.stepping, "parking_parallel", 512, rounds, step_s, rays=32),
        ),
        **_against_envpool(rounds, step_s),
        "evaluation.500_scenes.wall_s": Figure(
            "<=", 1, partial(simulation.evaluation, 50 if quick else 500, rounds)
        ),
        "decision.agent.ms": Figure(">=", 0, partial(decisions.agent_ms, rounds)),
        "decision.planner.ms": Figure(">=", 0, partial(decisions.planner_ms, rounds)),
        **_updates(rounds, quick=quick),
        "run.tutorial.ratio": Figure(
            ">=", 1.8, partial(training.tutorial, rounds, rounds * 8 if quick else 3000)
        ),
        "run.fetch_reach.cost": Figure(
            "<=", 0.6, partial(training.fetch_reach, rounds, rounds * (80 if quick else 400))
        ),
        "run.default.overhead": Figure(
            "<=", 1.25, partial(training.overhead, few, *(SHORT_RUN if quick else ()))
        ),
        "her.sample.capacity_ratio": Figure(
            "<=", 1.3, partial(buffers.capacity_ratio, capacity, samples, rounds)
        ),
        "her.sample.ratio": Figure(
            ">=", 5, partial(buffers.against_sb3, capacity, samples, rounds)
        ),
        "her.bytes_per_transition": Figure("<=", 150, partial(buffers.memory, capacity)),
        "sweep.scaling.2_workers": Figure(
            ">=",
            1.85,
            partial(
                sweeps.scaling,
                few,
                sweeps.SHORT if quick else ("total_timesteps=80000",),
                all_cores,
            ),
        ),
        "sweep.overhead_s_per_run": Figure(
            "<=", 6, partial(sweeps.overhead, 1 if quick else rounds, all_cores)
        ),
        "sweep.resume_scan_s.1000_runs": Figure(
            "<=", 2, partial(sweeps.scan, rounds, *((2, "buffer=replay") if quick else (30,)))
        ),
    }


def _against_envpool(rounds: int, seconds_per_side: float) -> dict[str, Figure]:
    """Return the figures of the simulator against EnvPool, which have no target."""
    figures = {}
    for n_scenes in (1, 2, 4, 8, 16):
        measure = partial(simulation.against_envpool, n_scenes, rounds, seconds_per_side)
        figures[f"simulator.n{n_scenes}.envpool.ratio"] = Figure(">=", 0, measure)
    return figures


def _updates(rounds: int, *, quick: bool) -> dict[str, Figure]:
    """Return the figures of updates against Stable-Baselines3, then those against sbx."""
    against_sb3 = {}
    against_sbx = {}
    for net, bound in (("3x256", 1.6), ("2x64", 2.0)):
        for algorithm in ("sac", "td3", "ddpg"):
            measure = partial(updates, algorithm, net, rounds, quick=quick)
            against_sb3[f"update.{algorithm}.{net}.ratio"] = Figure(
                ">=", bound, partial(measure, peer="stable-baselines3", gradient_steps=8)
            )
            if algorithm == "ddpg":  # sbx's does not support Dict observations
                continue
            for steps in (1, 8):
                against_sbx[f"update.{algorithm}.{net}.n{steps}.sbx.ratio"] = Figure(
                    ">=", 1, partial(measure, peer="sbx", gradient_steps=steps)
                )
    return against_sb3 | against_sbx

"""The figures of scripts/benchmark.py, with their targets."""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch

from benchmarks import cost_to_95, simulation, sweeps, training, updates
from benchmarks.buffers import Buffers

ALGORITHMS, NETS = ("sac", "td3", "ddpg"), {"3x256": "[256,256,256]", "2x64": "[64,64]"}
SBX_ALGORITHMS = ("sac", "td3")  # sbx's algorithms that support Dict observations
SBX_ROUNDS = (1, 8)  # gradient steps per round
TARGETS = {
    "simulator.n512.ratio": (">=", 3000.0),
    "simulator.n8.ratio": (">=", 250.0),
    "simulator.parked.n512.ratio": (">=", 1500.0),
    "evaluation.500_scenes.wall_s": ("<=", 1.0),
    **{f"update.{algorithm}.3x256.ratio": (">=", 1.6) for algorithm in ALGORITHMS},
    **{f"update.{algorithm}.2x64.ratio": (">=", 2.0) for algorithm in ALGORITHMS},
    **{
        f"update.{algorithm}.{net}.n{steps}.sbx.ratio": (">=", 1.0)
        for algorithm in SBX_ALGORITHMS
        for net in NETS
        for steps in SBX_ROUNDS
    },
    "run.tutorial.ratio": (">=", 1.8),
    "run.to_95.ratio": (">=", 50.0),
    "run.whole.ratio": (">=", 40.0),
    "run.default.overhead": ("<=", 1.25),
    "her.sample.capacity_ratio": ("<=", 1.3),
    "her.sample.ratio": (">=", 5.0),
    "her.bytes_per_transition": ("<=", 150.0),
    "her.save.bytes_per_transition": ("<=", 120.0),
    "sweep.scaling.2_workers": (">=", 1.85),
    "sweep.overhead_s_per_run": ("<=", 6.0),
    "sweep.resume_scan_s.1000_runs": ("<=", 2.0),
}
SLOW = ("run.to_95.ratio", "run.whole.ratio")  # the peer trains for two hours, once per machine
QUICK_ROUNDS, SEEDS = 2, 3
# Untrained agents time out, and highway-env is slow on long episodes.
QUICK_RUN = (
    "n_envs=8",
    "updates_per_step=1",
    "algorithm.learning_starts=900",
    "env.duration=4",
    "evaluation.every_n_steps=400",
    "evaluation.n_scenes=5",
    "evaluation.final_n_scenes=5",
    "evaluation.video_episodes=1",
)
Figures = dict[str, Callable[[], dict[str, Any]]]


def all_figures(settings: Any, all_cores: list[int]) -> Figures:
    """Return a function that measures each figure, by its key.

    Args:
        settings: arguments of the command line.
        all_cores: cores that sweeps may use; everything else runs on one.
    """
    torch.set_num_threads(1)
    quick = settings.quick
    rounds = min(settings.rounds, QUICK_ROUNDS) if quick else settings.rounds
    peer = Path(settings.output_dir) / ("benchmark_peer_quick.json" if quick else "benchmark_peer.json")
    costs = (
        partial(cost_to_95.costs, peer, 1, *QUICK_RUN, "total_timesteps=1200", every=300, most=900)
        if quick
        else partial(cost_to_95.costs, peer, SEEDS)
    )

    def stepping(scenes: int, option: str) -> dict[str, Any]:
        env = training.run_config(f"env={option}").env
        return simulation.stepping(env, scenes, rounds, seconds=0.1 if quick else 0.5)

    @cache  # two figures share the trained policy
    def overhead() -> tuple[dict[str, Any], Any]:
        # The full length: agents that have learned less time out, and the cross-check takes longer.
        steps, slice_steps = (1200, 80) if quick else (training.run_config().total_timesteps, 5120)
        return training.overhead(rounds, steps, slice_steps, *(QUICK_RUN if quick else ()))

    @cache
    def buffers() -> Buffers:
        return Buffers(training.run_config(), 200_000 if quick else 1_000_000, samples=20 if quick else 1000)

    return {
        "run.to_95.ratio": partial(costs, whole=False),
        "run.whole.ratio": partial(costs, whole=True),
        "simulator.n512.ratio": partial(stepping, 512, "parking"),
        "simulator.n8.ratio": partial(stepping, 8, "parking"),
        "simulator.parked.n512.ratio": partial(stepping, 512, "parking_crowded"),
        "run.default.overhead": lambda: overhead()[0],
        "evaluation.500_scenes.wall_s": lambda: simulation.bulk_evaluation(
            overhead()[1], training.run_config().env, 50 if quick else 500, rounds
        ),
        **_updates(quick, rounds),
        "run.tutorial.ratio": partial(training.tutorial, rounds, steps=rounds * 8 if quick else 3000),
        "her.sample.capacity_ratio": lambda: buffers().capacity_ratio(rounds),
        "her.sample.ratio": lambda: buffers().against_sb3(rounds),
        "her.bytes_per_transition": lambda: buffers().memory(),
        "her.save.bytes_per_transition": lambda: buffers().file(),
        "sweep.scaling.2_workers": partial(
            sweeps.scaling, 1 if quick else min(rounds, 3), None if quick else 80_000, all_cores
        ),
        "sweep.overhead_s_per_run": partial(sweeps.overhead, 1 if quick else rounds, all_cores),
        "sweep.resume_scan_s.1000_runs": partial(sweeps.scan, rounds, *((2, "buffer=replay") if quick else (30,))),
    }


def _updates(quick: bool, rounds: int) -> Figures:
    """Return the figures of updates against Stable-Baselines3, then those against sbx."""

    def update(algorithm: str, net: str, gradient_steps: int = 8, sbx: bool = False) -> dict[str, Any]:
        wide = net == "3x256"
        # As in experiment=tutorial; sbx has no other features.
        options = (["algorithm.features=raw"] if wide or sbx else []) + (["precision=medium"] if wide else [])
        options += ["n_envs=8", f"updates_per_step={gradient_steps / 8}", "algorithm.learning_starts=1000"]
        config = training.run_config(
            f"algorithm={algorithm}", f"algorithm.net_arch={NETS[net]}", "algorithm.batch_size=256", *options
        )
        slices = (4 if quick else 16) if wide else (16 if quick else 80)
        compare = updates.updates_against_sbx if sbx else updates.updates
        return compare(config, rounds, slices, transitions=2000 if quick else 10_000)

    pairs = [(algorithm, net) for net in NETS for algorithm in ALGORITHMS]
    return {f"update.{algorithm}.{net}.ratio": partial(update, algorithm, net) for algorithm, net in pairs} | {
        f"update.{algorithm}.{net}.n{steps}.sbx.ratio": partial(update, algorithm, net, steps, sbx=True)
        for algorithm, net in pairs
        if algorithm in SBX_ALGORITHMS
        for steps in SBX_ROUNDS
    }

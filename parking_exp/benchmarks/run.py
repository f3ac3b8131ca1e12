"""Run the benchmarks and compare them with their targets: mostly ratios to a peer, measured in turn on one core."""

import importlib.util
import os
from collections.abc import Callable, Iterator
from functools import partial
from importlib.metadata import distributions
from pathlib import Path
from typing import Annotated, Any, Literal

from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config.paths import directory_path
from parking_exp.config.schema import ConfigModel, Positive
from parking_exp.config.validate import parse
from parking_exp.errors import ConfigError, suggestion
from parking_exp.resources import cores
from parking_exp.runs.files import read_json, write_json
from parking_exp.terminal import say

ALGORITHMS, NETS = ("sac", "td3", "ddpg"), {"3x256": "[256,256,256]", "2x64": "[64,64]"}
SBX_ALGORITHMS = ("sac", "td3")  # those of sbx that take observations with goals
SBX_ROUNDS = (1, 8)  # gradient steps of a round
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
    "run.article.ratio": (">=", 1.8),
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
SLOW = ("run.to_95.ratio", "run.whole.ratio")  # the peer trains for two hours, once on a machine
QUICK_ROUNDS, SEEDS = 2, 3
# An agent that has just begun to learn drives every episode to its end, and highway-env takes its time for that.
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
NEEDS = ("highway_env", "stable_baselines3")
SBX_NEEDS = (*NEEDS, "sbx")  # the extra `bench`
Figures = dict[str, Callable[[], dict[str, Any]]]


class BenchmarkConfig(ConfigModel):
    """The config of scripts/benchmark.py."""

    output_dir: str
    only: Annotated[list[str], Field(min_length=1)] | None
    rounds: Positive
    quick: bool
    core: Annotated[int, Field(ge=0)] | Literal["first"] | None


def validate_benchmark(config: DictConfig) -> BenchmarkConfig:
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with a sentence for each thing that is wrong.
    """
    settings = parse(BenchmarkConfig, config)
    for name in settings.only or []:
        if not any(key.startswith(name) for key in TARGETS):
            raise ConfigError(f"only={name}: no figure begins so{suggestion(name, TARGETS)}")
    if isinstance(settings.core, int) and hasattr(os, "sched_getaffinity"):
        wanted, allowed = settings.core, os.sched_getaffinity(0)
        if wanted not in allowed:
            nearest = min(allowed, key=lambda core: abs(core - wanted))
            raise ConfigError(f"core={wanted}: this process may not run there; the closest is {nearest}")
    return settings


def benchmark(config: DictConfig) -> Path:
    """Measure, print a table, and write `benchmark.json` under the output directory; return its path."""
    settings = validate_benchmark(config)
    all_cores = cores()
    if settings.core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0)) if settings.core == "first" else settings.core})
    import torch
    from rich.console import Console

    torch.set_num_threads(1)
    results: dict[str, dict[str, Any]] = {}
    with Console(stderr=True).status("starting") as status:
        for key, measure in _figures(settings, all_cores):
            status.update(key)
            needs = SBX_NEEDS if ".sbx." in key else NEEDS
            absent = [name for name in needs if importlib.util.find_spec(name) is None]
            results[key] = {"missing": f"{', '.join(absent)} not installed"} if absent else measure()
    path = directory_path(settings.output_dir) / "benchmark.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    # A figure that is not measured this time stays as it was.
    earlier = read_json(path) or {}
    about = {"quick": settings.quick, "core": settings.core, "versions": _versions()}
    write_json(path, {**earlier, **{key: {**entry, "about": about} for key, entry in results.items()}})
    say(*_table(results))
    if settings.quick:
        say("--quick: these figures only show that everything runs")
    say(f"written to {path}")
    return path


def _figures(settings: BenchmarkConfig, all_cores: list[int]) -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """Yield key and measurement of every figure that is asked for."""
    for key, measure in {**_single_core(settings), **_sweeps(settings, all_cores)}.items():
        asked = any(key.startswith(name) for name in settings.only or [])
        if asked or (settings.only is None and key not in SLOW):
            yield key, measure


def _sweeps(settings: BenchmarkConfig, all_cores: list[int]) -> Figures:
    """Return the figures of whole sweeps, which use all cores."""

    def measure(name: str, *arguments: Any) -> Callable[[], dict[str, Any]]:
        def measured() -> dict[str, Any]:
            from parking_exp.benchmarks import sweeps

            return getattr(sweeps, name)(*arguments)

        return measured

    quick, rounds = settings.quick, _rounds(settings)
    few = 1 if quick else min(rounds, 3)  # whole sweeps take their time
    return {
        "sweep.scaling.2_workers": measure("scaling", few, None if quick else 80_000, all_cores),
        "sweep.overhead_s_per_run": measure("overhead", 1 if quick else rounds, all_cores),
        "sweep.resume_scan_s.1000_runs": measure("scan", rounds, 2, "buffer=replay")
        if quick
        else measure("scan", rounds, 30),
    }


def _rounds(settings: BenchmarkConfig) -> int:
    return min(settings.rounds, QUICK_ROUNDS) if settings.quick else settings.rounds


def _stepping(settings: BenchmarkConfig, scenes: int, option: str) -> dict[str, Any]:
    from parking_exp.benchmarks import simulation, training

    env = training.run_config(f"env={option}").env
    return simulation.stepping(env, scenes, _rounds(settings), seconds=0.1 if settings.quick else 0.5)


def _update(settings: BenchmarkConfig, algorithm: str, net: str, *, gradient_steps: int = 8, sbx: bool = False) -> Any:
    from parking_exp.benchmarks import training, updates

    quick, wide = settings.quick, net == "3x256"
    # As experiment=article has it; sbx knows no other features.
    options = (["algorithm.features=raw"] if wide or sbx else []) + (["precision=auto"] if wide else [])
    options += ["n_envs=8", f"updates_per_step={gradient_steps / 8}", "algorithm.learning_starts=1000"]
    config = training.run_config(
        f"algorithm={algorithm}", f"algorithm.net_arch={NETS[net]}", "algorithm.batch_size=256", *options
    )
    slices = (4 if quick else 16) if wide else (16 if quick else 80)
    compare = updates.updates_against_sbx if sbx else updates.updates
    return compare(config, _rounds(settings), slices, transitions=2000 if quick else 10_000)


def _updates(settings: BenchmarkConfig) -> Figures:
    """Return the figures of updates against Stable-Baselines3, then those against sbx."""
    update = partial(_update, settings)
    pairs = [(algorithm, net) for net in NETS for algorithm in ALGORITHMS]
    return {f"update.{algorithm}.{net}.ratio": partial(update, algorithm, net) for algorithm, net in pairs} | {
        f"update.{algorithm}.{net}.n{steps}.sbx.ratio": partial(update, algorithm, net, gradient_steps=steps, sbx=True)
        for algorithm, net in pairs
        if algorithm in SBX_ALGORITHMS
        for steps in SBX_ROUNDS
    }


def _cost_to_95(settings: BenchmarkConfig, name: str) -> dict[str, Any]:
    from parking_exp.benchmarks import cost_to_95

    peer = directory_path(settings.output_dir) / cost_to_95.PEER_FILE
    if settings.quick:
        path, shorter = peer.with_stem(f"{peer.stem}_quick"), (*QUICK_RUN, "total_timesteps=1200")
        return getattr(cost_to_95, name)(path, 1, *shorter, every=300, most=900)
    return getattr(cost_to_95, name)(peer, SEEDS)


def _single_core(settings: BenchmarkConfig) -> Figures:
    """Return the figures of a single process."""
    quick, rounds = settings.quick, _rounds(settings)
    kept: dict[str, Any] = {}  # the policy trained for one figure serves another

    def overhead() -> dict[str, Any]:
        from parking_exp.benchmarks import training

        # As long as the run: an agent that has learned less times out, and certifying that takes longer than training.
        steps, slice_steps = (1200, 80) if quick else (training.run_config().total_timesteps, 5120)
        entry, kept["policy"] = training.overhead(rounds, steps, slice_steps, *(QUICK_RUN if quick else ()))
        return entry

    def evaluation() -> dict[str, Any]:
        from parking_exp.benchmarks import simulation, training

        if "policy" not in kept:
            overhead()
        return simulation.bulk_evaluation(kept["policy"], training.run_config().env, 50 if quick else 500, rounds)

    def article() -> dict[str, Any]:
        from parking_exp.benchmarks import training

        return training.article(rounds, steps=rounds * 8 if quick else 3000)

    def buffers() -> Any:
        from parking_exp.benchmarks import training
        from parking_exp.benchmarks.buffers import Buffers

        if "buffers" not in kept:
            kept["buffers"] = Buffers(
                training.run_config(), 200_000 if quick else 1_000_000, samples=20 if quick else 1000
            )
        return kept["buffers"]

    return {
        "run.to_95.ratio": lambda: _cost_to_95(settings, "to_95"),
        "run.whole.ratio": lambda: _cost_to_95(settings, "whole_run"),
        "simulator.n512.ratio": lambda: _stepping(settings, 512, "parking"),
        "simulator.n8.ratio": lambda: _stepping(settings, 8, "parking"),
        "simulator.parked.n512.ratio": lambda: _stepping(settings, 512, "parking_parked"),
        "run.default.overhead": overhead,
        "evaluation.500_scenes.wall_s": evaluation,
        **_updates(settings),
        "run.article.ratio": article,
        "her.sample.capacity_ratio": lambda: buffers().capacity_ratio(rounds),
        "her.sample.ratio": lambda: buffers().against_sb3(rounds),
        "her.bytes_per_transition": lambda: buffers().memory(),
        "her.save.bytes_per_transition": lambda: buffers().file(),
    }


def _versions() -> dict[str, str]:
    installed = {str(item.metadata["Name"]).lower(): item.version for item in distributions()}
    names = ("parking-exp", "torch", "stable-baselines3", "highway-env", "numpy", "sbx-rl", "jax")
    return {name: installed[name] for name in names if name in installed}


def _table(results: dict[str, dict[str, Any]]) -> list[str]:
    lines = [f"{'figure':<30}{'median':>9}  {'spread':<19}{'target':<10}  peer"]
    for key, entry in results.items():
        sign, bound = TARGETS[key]
        target = f"{sign} {bound:g}"
        if "missing" in entry:
            lines.append(f"{key:<30}{'-':>9}  {'':<19}{target:<10}  {entry['missing']}")
            continue
        value = next(entry[name] for name in ("ratio", "wall_s", "bytes", "seconds") if name in entry)
        met = value >= bound if sign == ">=" else value <= bound
        low, high = entry["lowest"], entry["highest"]
        words = f"{target:<10}  {entry.get('peer', '')}{'' if met else '   MISSED'}"
        lines.append(f"{key:<30}{value:>9.4g}  {f'{low:.4g} to {high:.4g}':<19}{words}")
    return lines

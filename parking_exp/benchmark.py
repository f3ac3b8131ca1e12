"""Speed as ratios: each figure against a named peer, both measured in turn in one run on the same core."""

import importlib.util
import os
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config import Positive, Section
from parking_exp.errors import ConfigError
from parking_exp.files import write_json
from parking_exp.validation import parse
from parking_exp.wording import closest

ALGORITHMS, NETS = ("sac", "td3", "ddpg"), {"3x256": "[256,256,256]", "2x64": "[64,64]"}
TARGETS = {
    "simulator.n512.ratio": (">=", 3000.0),
    "simulator.n8.ratio": (">=", 250.0),
    "simulator.parked.n512.ratio": (">=", 1500.0),
    "evaluation.500_scenes.wall_s": ("<=", 1.0),
    **{f"update.{algorithm}.3x256.ratio": (">=", 1.6) for algorithm in ALGORITHMS},
    **{f"update.{algorithm}.2x64.ratio": (">=", 2.0) for algorithm in ALGORITHMS},
    "run.article.ratio": (">=", 1.8),
    "run.default.overhead": ("<=", 1.03),
}
PEERS = {
    "simulator": ("highway_env",),
    "update": ("stable_baselines3",),
    "run.article": ("stable_baselines3", "highway_env"),
}


class BenchmarkConfig(Section):
    """The config of scripts/benchmark.py."""

    output_dir: str
    only: list[str] | None
    rounds: Positive
    quick: bool
    core: Annotated[int, Field(ge=0)] | None


def validate_benchmark(config: DictConfig) -> BenchmarkConfig:
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with a sentence for each thing that is wrong.
    """
    settings = parse(BenchmarkConfig, config)
    for name in settings.only or []:
        if not any(key.startswith(name) for key in TARGETS):
            raise ConfigError(f"only={name}: no figure begins so{closest(name, TARGETS)}")
    if settings.core is not None and hasattr(os, "sched_getaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        if settings.core not in cores:
            raise ConfigError(f"core={settings.core}: this process may run on {cores}; the closest is {cores[-1]}")
    return settings


def benchmark(config: DictConfig) -> Path:
    """Measure, print a table, and write `benchmark.json` under the output directory; return its path."""
    settings = validate_benchmark(config)
    if settings.core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {settings.core})
    import torch
    from rich.console import Console

    torch.set_num_threads(1)
    console = Console(stderr=True)
    results: dict[str, dict[str, Any]] = {}
    with console.status("starting") as status:
        for key, measure in _figures(settings):
            status.update(key)
            missing = _missing(key)
            results[key] = {"missing": missing} if missing else measure()
    path = Path(settings.output_dir).expanduser().absolute() / "benchmark.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    about = {"quick": settings.quick, "core": settings.core, "versions": _versions()}
    write_json(path, {**results, "about": about})
    print(_table(results))
    print(f"written to {path}")
    return path


def _figures(settings: BenchmarkConfig) -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """Yield key and measurement of every figure that is asked for."""
    from parking_exp.measurements import runs, simulation, updates

    quick, rounds = settings.quick, settings.rounds
    kept: dict[str, Any] = {}  # the policy trained for one figure serves another

    def stepping(scenes: int, option: str) -> dict[str, Any]:
        env = runs.run_config(f"env={option}").env
        return simulation.stepping(env, scenes, rounds, seconds=0.1 if quick else 1.0)

    def update(algorithm: str, net: str) -> dict[str, Any]:
        wide = "256" in net
        features = ["algorithm.features=raw"] if wide else []  # as the tutorial has it
        config = runs.run_config(
            f"algorithm={algorithm}", f"algorithm.net_arch={net}", "algorithm.batch_size=256", *features
        )
        return updates.updates(config, rounds, updates_a_slice=(8 if quick else 24) if wide else (16 if quick else 120))

    def overhead() -> dict[str, Any]:
        steps, slice_steps = (1400, 80) if quick else (20_000, 1000)
        entry, kept["policy"] = runs.overhead(rounds, steps, slice_steps)
        return entry

    def evaluation() -> dict[str, Any]:
        if "policy" not in kept:
            overhead()
        return simulation.bulk_evaluation(kept["policy"], runs.run_config().env, 500, rounds)

    figures: dict[str, Callable[[], dict[str, Any]]] = {
        "simulator.n512.ratio": lambda: stepping(512, "parking"),
        "simulator.n8.ratio": lambda: stepping(8, "parking"),
        "simulator.parked.n512.ratio": lambda: stepping(512, "parking_parked"),
        "run.default.overhead": overhead,
        "evaluation.500_scenes.wall_s": evaluation,
        **{
            f"update.{algorithm}.{name}.ratio": lambda algorithm=algorithm, net=net: update(algorithm, net)  # type: ignore[misc]
            for name, net in NETS.items()
            for algorithm in ALGORITHMS
        },
        "run.article.ratio": lambda: runs.article(rounds, steps=rounds * 8 if quick else 3000),
    }
    for key, measure in figures.items():
        if settings.only is None or any(key.startswith(name) for name in settings.only):
            yield key, measure


def _missing(key: str) -> str | None:
    """Return what a figure's peer needs and is not installed."""
    needs = next((modules for prefix, modules in PEERS.items() if key.startswith(prefix)), ())
    absent = [name for name in needs if importlib.util.find_spec(name) is None]
    return f"{', '.join(absent)} not installed" if absent else None


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("parking-exp", "torch", "stable-baselines3", "highway-env", "numpy")}


def _table(results: dict[str, dict[str, Any]]) -> str:
    lines = [f"{'figure':<30}{'median':>9}  {'spread':<19}{'target':<10}  peer"]
    for key, entry in results.items():
        sign, bound = TARGETS[key]
        target = f"{sign} {bound:g}"
        if "missing" in entry:
            lines.append(f"{key:<30}{'-':>9}  {'':<19}{target:<10}  {entry['missing']}")
            continue
        value = entry["wall_s"] if key.endswith("wall_s") else entry["ratio"]
        met = value >= bound if sign == ">=" else value <= bound
        low, high = entry["lowest"], entry["highest"]
        words = f"{target:<10}  {entry.get('peer', '')}{'' if met else '   MISSED'}"
        lines.append(f"{key:<30}{value:>9.4g}  {f'{low:.4g} to {high:.4g}':<19}{words}")
    return "\n".join(lines)

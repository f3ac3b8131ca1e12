#!/usr/bin/env python
"""Measure speed relative to named peers, alternating between both sides, on one core of an otherwise idle machine.

simulator.*            env steps/s against highway-env, random actions, 512 or 8 scenes at once
evaluation.*           seconds to evaluate a trained policy on 500 scenes
update.*               updates/s, sampling included, against Stable-Baselines3's train(); 3x256 with precision=medium
update.*.sbx.ratio     the same with raw features against sbx (JAX) on our replay buffer; n1, n8: updates per round
run.tutorial.ratio     env steps/s of the tutorial's recipe against plain Stable-Baselines3 + highway-env
run.to_95.ratio        CPU time of training to 95 % success: the tutorial's recipe / the default, medians of three seeds
run.whole.ratio        CPU time of the tutorial's recipe to 95 % / CPU time of a whole default run
run.default.overhead   wall time of the default run / of its training without tracking, checkpoints, evaluation
her.sample.*           time of a HER minibatch: large buffer / small one; samples/s against Stable-Baselines3
her.*bytes*            bytes per transition, in memory and in a saved buffer
sweep.scaling.*        runs per hour with two workers / with one
sweep.overhead_*       seconds per run besides training
sweep.resume_scan_*    seconds to read the state of 1,000 runs

Arguments:
  output_dir=outputs   benchmark.json is written there
  only=[PREFIX,...]    figures to measure; default: all except run.to_95 and run.whole, whose peer trains for two hours
                       (once per machine)
  rounds=5             measurements per figure
  core=first           core to pin to: a number, first (the first allowed core), or null
  --quick              check in two to three minutes that everything runs; the figures are not meaningful

update.*.sbx.ratio needs: pip install 'parking-exp[bench]'
"""

import importlib.util
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console

from parking_exp.resources import cores
from parking_exp.runs.atomic_files import read_json, write_json

VERSIONS = ("parking-exp", "torch", "stable-baselines3", "highway-env", "numpy", "sbx-rl", "jax")


@dataclass
class Settings:
    """The arguments of the command line."""

    output_dir: str = "outputs"
    only: list[str] | None = None
    rounds: int = 5
    quick: bool = False
    core: str | None = "first"


def main() -> None:
    """Measure the chosen figures, print a table and write `benchmark.json`."""
    arguments = ["quick=true" if argument == "--quick" else argument for argument in sys.argv[1:]]
    if {"-h", "--help"} & set(arguments):
        print(__doc__)
        return
    try:
        settings: Any = OmegaConf.to_object(
            OmegaConf.merge(OmegaConf.structured(Settings), OmegaConf.from_cli(arguments))
        )
    except OmegaConfBaseException as error:
        sys.exit(f"error: {str(error).splitlines()[0]}")
    all_cores = cores()
    try:
        if settings.core is not None and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {min(all_cores) if settings.core == "first" else int(settings.core)})
    except (ValueError, OSError):
        sys.exit(f"error: core={settings.core} is not one of {', '.join(map(str, all_cores))}")
    from benchmarks import figures  # imports torch, which reads the available cores

    if settings.rounds < 1:
        sys.exit(f"error: rounds={settings.rounds} is less than 1")
    for prefix in settings.only or []:
        if not any(key.startswith(prefix) for key in figures.TARGETS):
            sys.exit(f"error: only={prefix}: no figure starts with this; see --help")
    prefixes = tuple(settings.only or (key for key in figures.TARGETS if key not in figures.SLOW))
    chosen = {
        key: measure for key, measure in figures.all_figures(settings, all_cores).items() if key.startswith(prefixes)
    }
    results = _measure(chosen)
    path = Path(settings.output_dir) / "benchmark.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    about = {"quick": settings.quick, "core": settings.core, "versions": _versions()}
    earlier = read_json(path) or {}  # figures that are not measured this time are kept
    write_json(path, {**earlier, **{key: {**entry, "about": about} for key, entry in results.items()}})
    print(*_table(results, figures.TARGETS), f"written to {path}", sep="\n")


def _measure(chosen: dict[str, Callable[[], dict[str, Any]]]) -> dict[str, dict[str, Any]]:
    results = {}
    with Console(stderr=True).status("starting") as status:
        for key, measure in chosen.items():
            status.update(key)
            missing = ".sbx." in key and importlib.util.find_spec("sbx") is None
            results[key] = {"missing": "sbx not installed"} if missing else measure()
    return results


def _versions() -> dict[str, str]:
    installed = {str(item.metadata["Name"]).lower(): item.version for item in distributions()}
    return {name: installed[name] for name in VERSIONS if name in installed}


def _table(results: dict[str, dict[str, Any]], targets: dict[str, tuple[str, float]]) -> list[str]:
    lines = [f"{'figure':<30}{'median':>9}  {'spread':<19}{'target':<10}  peer"]
    for key, entry in results.items():
        sign, bound = targets[key]
        target = f"{sign} {bound:g}"
        if "missing" in entry:
            lines.append(f"{key:<30}{'-':>9}  {'':<19}{target:<10}  {entry['missing']}")
            continue
        value = next(entry[name] for name in ("ratio", "wall_s", "bytes", "seconds") if name in entry)
        met = value >= bound if sign == ">=" else value <= bound
        spread = f"{entry['lowest']:.4g} to {entry['highest']:.4g}"
        remark = f"{target:<10}  {entry.get('peer', '')}{'' if met else '   MISSED'}"
        lines.append(f"{key:<30}{value:>9.4g}  {spread:<19}{remark}")
    return lines


if __name__ == "__main__":
    main()

#!/usr/bin/env python
"""Measure speed relative to named peers, on one core; other programs should be idle.

Measurements alternate between both sides.

simulator.*            env steps/s against highway-env, random actions, 512 or 8 scenes at once
simulator.*.envpool.ratio  env steps/s against EnvPool in one thread, 1 to 16 scenes at once; no
                       target
evaluation.*           seconds to evaluate a trained policy on 500 scenes
decision.*.ms          milliseconds of pretrained/parallel, and of the planner once it has a plan,
                       for an action in one scene; no target
update.*               updates/s, sampling included, against Stable-Baselines3's train();
                       3x256 with precision=medium
update.*.sbx.ratio     the same with raw features against sbx (JAX) on our replay buffer;
                       n1, n8: updates per round
run.tutorial.ratio     env steps/s of Stable-Baselines3's example against plain Stable-Baselines3 +
                       highway-env
run.fetch_reach.cost   CPU time per env step, updates included, of env=fetch_reach / of plain
                       Stable-Baselines3
run.default.overhead   wall time of the default run / of its training without tracking, checkpoints,
                       evaluation
her.sample.*           time of a HER minibatch: large buffer / small one; samples/s against
                       Stable-Baselines3
her.*bytes*            bytes per transition, in memory and in a saved buffer
sweep.scaling.*        runs per hour with two workers / with one
sweep.overhead_*       seconds per run besides training
sweep.resume_scan_*    seconds to read the state of 1,000 runs

Arguments:
  output_dir=outputs   benchmark.json is written there
  only=[PREFIX,...]    figures to measure; default: all
  rounds=5             measurements per figure; of whole runs at most 3
  core=first           core to pin to: a number, first (the first allowed core), or null
  --quick              check in two to three minutes that everything runs; the figures mean
                       nothing

update.*.sbx.ratio needs: pip install 'parking-exp[bench]'
simulator.*.envpool.ratio needs: pip install envpool
decision.planner.ms needs: pip install 'parking-exp[planning]'
"""

import os
import sys
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.foreign_files import read_json
from parking_exp.sweeps.resources import available_cores

VERSIONS = ("parking-exp", "torch", "stable-baselines3", "highway-env", "numpy", "sbx-rl", "jax")
PEERS = {
    ".sbx.": "sbx-rl",
    ".envpool.": "envpool",
    ".planner.": "ompl",
}  # packages that some figures need


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
    all_cores = available_cores()
    try:
        if settings.core is not None and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(
                0, {min(all_cores) if settings.core == "first" else int(settings.core)}
            )
    except (ValueError, OSError):
        sys.exit(f"error: core={settings.core} is not one of {', '.join(map(str, all_cores))}")
    if settings.rounds < 1:
        sys.exit(f"error: rounds={settings.rounds} is less than 1")
    import torch  # reads the available cores

    from benchmarks.figures import figures

    torch.set_num_threads(1)
    rounds = min(settings.rounds, 2) if settings.quick else settings.rounds
    all_figures = figures(rounds, all_cores, quick=settings.quick)
    for prefix in settings.only or []:
        if not any(key.startswith(prefix) for key in all_figures):
            sys.exit(f"error: only={prefix}: no figure starts with this; see --help")
    chosen = {
        key: all_figures[key] for key in all_figures if key.startswith(tuple(settings.only or [""]))
    }
    path = Path(settings.output_dir) / "benchmark.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    results = read_json(path) or {}  # figures that are not measured this time are kept
    installed = {str(item.metadata["Name"]).lower(): item.version for item in distributions()}
    versions = {name: installed[name] for name in VERSIONS if name in installed}
    about = {"quick": settings.quick, "core": settings.core, "versions": versions}
    print(f"{'figure':<30}{'median':>9}  {'range':<19}{'target':<10}  peer")
    for key, figure in chosen.items():
        missing = [
            package for part, package in PEERS.items() if part in key and package not in installed
        ]
        if missing:
            print(f"{key:<30}{'-':>9}  {missing[0]} is not installed")
            continue
        results[key] = {**figure.measure(), "about": about}
        print(_row(key, figure.sign, figure.bound, results[key]), flush=True)
        write_json(path, results)
    print(f"written to {path}")


def _row(key: str, sign: str, bound: float, entry: dict[str, Any]) -> str:
    value = entry["value"]
    values = f"{entry['lowest']:.4g} to {entry['highest']:.4g}"
    target = f"{sign} {bound:g}"
    is_met = value >= bound if sign == ">=" else value <= bound
    missed = "" if is_met else "   MISSED"
    peer = entry.get("peer", "")
    return f"{key:<30}{value:>9.4g}  {values:<19}{target:<10}  {peer}{missed}"


if __name__ == "__main__":
    main()

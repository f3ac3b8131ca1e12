"""Speed as ratios: each figure against a named peer, both measured in one run on the same core."""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from omegaconf import DictConfig
from pydantic import Field

from parking_exp.config import Positive, Section
from parking_exp.files import write_json
from parking_exp.validation import parse

# Evaluation is what a run is for, not overhead: one scene stands in for it.
TRACKED = [
    "evaluation.every_n_steps=null", "evaluation.n_scenes=1", "evaluation.final_n_scenes=1",
    "evaluation.video_episodes=0", "tracking.progress_bar=false",
]  # fmt: skip
TRACKED_SIDE = "import sys; from parking_exp.cli import train; sys.argv[1:] = {overrides!r}; train()"
BARE_SIDE = """
import json, sys, torch
from stable_baselines3.common.logger import Logger
from parking_exp.algorithms import build_model
from parking_exp.config import RunConfig
from parking_exp.envs.vector import make_training_envs
config = RunConfig.model_validate(json.load(sys.stdin))
torch.set_num_threads(config.torch_threads or torch.get_num_threads())
model = build_model(config, make_training_envs(config.env, config.n_envs), seed=config.seed)
model.set_logger(Logger(None, []))
model.learn(config.total_timesteps)
"""


class BenchmarkConfig(Section):
    """The config of scripts/benchmark.py."""

    output_dir: str
    steps: Positive | None
    rounds: Positive
    core: Annotated[int, Field(ge=0)] | None


def benchmark(config: DictConfig) -> Path:
    """Measure, print a table, and write `benchmark.json` under the output directory; return its path."""
    settings = parse(BenchmarkConfig, config)
    if settings.core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {settings.core})
    results = {"run.default.overhead": _overhead(settings)}
    path = Path(settings.output_dir).expanduser().absolute() / "benchmark.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, results)
    for key, entry in results.items():
        print(f"{key}  {entry['ratio']:.3f}  (ours {entry['ours_s']} s, bare Stable-Baselines3 {entry['peer_s']} s)")
    print(f"written to {path}")
    return path


def _overhead(settings: BenchmarkConfig) -> dict[str, float | list[float]]:
    from parking_exp.composition import composed
    from parking_exp.validation import validate

    steps = [] if settings.steps is None else [f"total_timesteps={settings.steps}"]
    ours, peer = [], []
    for number in range(settings.rounds):
        with tempfile.TemporaryDirectory() as folder:
            overrides = [*TRACKED, *steps, f"seed={number}", f"output_dir={folder}"]
            (point,) = composed("config", overrides)
            ours.append(_seconds(TRACKED_SIDE.format(overrides=overrides), ""))
            peer.append(_seconds(BARE_SIDE, json.dumps(validate(point).plain())))
    ratios = [mine / theirs for mine, theirs in zip(ours, peer, strict=True)]
    return {
        "ratio": statistics.median(ratios),
        "lowest": min(ratios),
        "highest": max(ratios),
        "ours_s": _rounded(ours),
        "peer_s": _rounded(peer),
    }


def _seconds(code: str, text: str) -> float:
    """Wall seconds of a fresh Python process, its imports included."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], input=text, text=True, check=True, capture_output=True)
    return time.perf_counter() - start


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 1) for value in values]

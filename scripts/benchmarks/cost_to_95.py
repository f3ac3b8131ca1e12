"""Benchmark the CPU time to 95 % success: the default recipe against the tutorial's."""

import math
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from benchmarks.timing import rounded, spread
from benchmarks.training import run_config, tutorial_model
from parking_exp.algorithms.build_model import build_model, greedy_policy, torch_settings
from parking_exp.algorithms.policy_ema import PolicyEMA
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import EnvConfig, RunConfig
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.evaluation.evaluate_policy import evaluate, summarise
from parking_exp.runs.atomic_files import read_object, write_json
from parking_exp.runs.run_provenance import provenance
from parking_exp.statistics.survival import steps_to
from parking_exp.training.loop import derive_seeds

N_SCENES = 200
THRESHOLD, HOLD = 0.95, 3  # success rate, and number of consecutive evaluations that have to reach it
PEER = "the tutorial's recipe in plain stable-baselines3 + highway-env"
PACKAGES = ("version.torch", "version.stable-baselines3", "version.highway-env", "version.numpy")
EVERY_UPDATES = 500  # updates between our evaluations
PEER_EVERY, PEER_MOST = 2500, 60_000  # env steps between evaluations, and in total (45 minutes)


class _Evaluations(BaseCallback):
    """Evaluations of the policy in the simulator during training, which stop it when 95 % is held.

    Args:
        env: the `env` group.
        every: env steps between evaluations.
        average: EMA of the policy, which is evaluated.

    Attributes:
        steps, rates, cpu_s: env steps, success rate and CPU time of training at each evaluation.
    """

    def __init__(self, env: EnvConfig, every: int, average: PolicyEMA) -> None:
        super().__init__()
        self.env, self.every, self.next, self.average = env, every, every, average
        self.steps: list[int] = []
        self.rates: list[float] = []
        self.cpu_s: list[float] = []
        self.uncounted = time.process_time()

    def _on_rollout_start(self) -> None:
        self.average.update()

    def _on_step(self) -> bool:
        if self.num_timesteps < self.next:
            return True
        self.next += self.every
        begin = time.process_time()
        assert isinstance(self.model, OffPolicyAlgorithm)
        with self.average.applied():
            episodes = evaluate(greedy_policy(self.model), self.env, range(N_SCENES))
        self.steps.append(self.num_timesteps)
        self.rates.append(summarise(episodes)["success_rate"])
        self.cpu_s.append(begin - self.uncounted)
        self.uncounted += time.process_time() - begin
        return len(self.rates) < HOLD or min(self.rates[-HOLD:]) < THRESHOLD

    def cost_s(self) -> float | None:
        """Return the CPU time of training until 95 % is held; None if it never is."""
        step, reached = steps_to(self.steps, self.rates, THRESHOLD, HOLD)
        return self.cpu_s[self.steps.index(int(step))] if reached else None


def peer_costs(path: Path, seeds: int, every: int = PEER_EVERY, most: int = PEER_MOST) -> list[float]:
    """Return the tutorial's CPU time to 95 % on each seed, cached in a file per machine and versions.

    For a seed that never holds 95 % it is its whole CPU time, a lower bound.
    """
    config = run_config("experiment=tutorial", "torch_threads=1")
    tags = provenance()
    machine = {name: tags[name] for name in sorted(tags) if name == "cpu" or name.startswith(PACKAGES)}
    settings = {"success": THRESHOLD, "evaluations": HOLD, "n_scenes": N_SCENES, "every": every, "most": most}
    about = {**machine, **settings, "threads": torch.get_num_threads(), "recipe": config.cell_key}
    path.parent.mkdir(parents=True, exist_ok=True)
    cached = read_object(path)
    entry = cached.setdefault(short_hash(about), {"about": about, "seeds": {}})
    for seed in map(str, range(seeds)):
        if seed not in entry["seeds"]:
            model = tutorial_model(config, int(seed))
            entry["seeds"][seed] = _cost_s(model, config, every, most)
            write_json(path, cached)
    return [entry["seeds"][str(seed)]["cost_s"] for seed in range(seeds)]


def _cost_s(model: OffPolicyAlgorithm, config: RunConfig, every: int, most: int) -> dict[str, Any]:
    """Train a model until 95 % is held, and return the CPU time and the learning curve."""
    model.set_logger(Logger(None, []))
    evaluations = _Evaluations(config.env, every, PolicyEMA(model, config.algorithm.policy_ema_half_life))
    model.learn(most, evaluations, log_interval=10**9)
    cost = evaluations.cost_s()
    curve = {
        "steps": evaluations.steps,
        "success": evaluations.rates,
        "cpu_s": [rounded(seconds) for seconds in evaluations.cpu_s],
    }
    return {"cost_s": rounded(evaluations.cpu_s[-1] if cost is None else cost), "reached": cost is not None, **curve}


def our_cost(config: RunConfig, every: int) -> dict[str, Any]:
    """Return the CPU time of a run's training to 95 %, counted as in `peer_costs`."""
    seeds = derive_seeds(config.seed)
    with torch_settings(config):
        env = make_training_envs(config.env, config.n_envs)
        model = build_model(config, env, seeds.policy)
        env.seed(seeds.training_scenes)
        return _cost_s(model, config, every, config.total_timesteps)


def costs(path: Path, seeds: int, *changes: str, whole: bool, **peer: int) -> dict[str, Any]:
    """Compare the CPU time to 95 % of the tutorial's recipe with the default one's: a ratio of medians over seeds.

    Args:
        path: cache of the peer's results.
        seeds: number of seeds.
        changes: overrides of the default recipe.
        whole: count our whole run, start of the process included, instead of training to 95 %. If False, a seed that
            never holds 95 % has a ratio of 0.
        peer: `every` and `most` of `peer_costs`.
    """
    peers = peer_costs(path, seeds, **peer)
    if whole:
        ours, rates = _whole_runs(seeds, *changes)
        extra: dict[str, Any] = {"ours_success_rate": rates}
    else:
        configs = [run_config(f"seed={seed}", *changes) for seed in range(seeds)]
        trained = [our_cost(config, _every(config)) for config in configs]
        ours, extra = [run["cost_s"] if run["reached"] else math.inf for run in trained], {}
    entry = spread([statistics.median(peers) / cost for cost in ours], "ratio")
    entry["ratio"] = rounded(statistics.median(peers) / statistics.median(ours))
    seconds = [rounded(cost) if math.isfinite(cost) else None for cost in ours]
    return entry | extra | {"ours_cpu_s": seconds, "peer_cpu_s": peers, "peer": PEER, "unit": "CPU-seconds"}


def _whole_runs(seeds: int, *changes: str) -> tuple[list[float], list[float]]:
    """Return CPU time and success rate of whole runs, each in its own process."""
    costs, rates = [], []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(seeds):
            code = "import sys; from parking_exp.cli.train import main; main()"
            command = [sys.executable, "-c", code, f"seed={seed}", f"output_dir={folder}", *changes]
            before = _children_s()
            subprocess.run(command, check=True, capture_output=True)
            costs.append(_children_s() - before)
            (result,) = Path(folder).rglob(f"seed={seed}/result.json")
            rates.append(read_object(result)["metrics"]["final/success_rate"])
    return costs, rates


def _every(config: RunConfig) -> int:
    """Return the env steps of EVERY_UPDATES updates."""
    return max(1, round(EVERY_UPDATES / config.updates_per_step))


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

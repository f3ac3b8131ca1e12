"""CPU time to 95 % success: the default recipe against the usual tutorial's."""

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
from parking_exp.algorithms.build import build_model, greedy_policy, torch_settings
from parking_exp.algorithms.policy_average import PolicyAverage
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import EnvConfig, RunConfig
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.evaluation.evaluate_policy import evaluate, summarise
from parking_exp.runs.files import read_object, write_json
from parking_exp.runs.provenance import provenance
from parking_exp.statistics.survival import steps_to
from parking_exp.training.seeding import derive_seeds

N_SCENES = 200
THRESHOLD, HOLD = 0.95, 3  # success that so many evaluations in a row have to reach
PEER = "the tutorial's recipe in plain stable-baselines3 + highway-env"
PACKAGES = ("version.torch", "version.stable-baselines3", "version.highway-env", "version.numpy")
EVERY_UPDATES = 500  # between evaluations of ours
PEER_EVERY, PEER_MOST = 2500, 60_000  # env steps between evaluations, and at most: 45 minutes, which understates


class _Evaluations(BaseCallback):
    """Evaluates the policy every so many env steps in the exact simulator, and stops when 95 % are held.

    Args:
        env: the `env` group.
        every: env steps between evaluations.
        average: of the policy, which is evaluated.

    Attributes:
        steps, rates, cpu_s: of each evaluation: env steps, success rate, CPU time of training until then.
    """

    def __init__(self, env: EnvConfig, every: int, average: PolicyAverage) -> None:
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
        """Return the CPU time of training until 95 % are held; None where they never are."""
        step, reached = steps_to(self.steps, self.rates, THRESHOLD, HOLD)
        return self.cpu_s[self.steps.index(int(step))] if reached else None


def peer_costs(path: Path, seeds: int, every: int = PEER_EVERY, most: int = PEER_MOST) -> list[float]:
    """Return the tutorial's CPU time to 95 % on each seed, from a file where this machine has measured it already.

    Of a seed that never holds 95 % it is all of its CPU time: less than it would take.
    """
    config = run_config("experiment=tutorial", "torch_threads=1")
    tags = provenance()
    machine = {name: tags[name] for name in sorted(tags) if name == "cpu" or name.startswith(PACKAGES)}
    asked = {"success": THRESHOLD, "evaluations": HOLD, "n_scenes": N_SCENES, "every": every, "most": most}
    about = {**machine, **asked, "threads": torch.get_num_threads(), "recipe": config.cell_key}
    path.parent.mkdir(parents=True, exist_ok=True)
    known = read_object(path)
    entry = known.setdefault(short_hash(about), {"about": about, "seeds": {}})
    for seed in map(str, range(seeds)):
        if seed not in entry["seeds"]:
            model = tutorial_model(config, int(seed))
            entry["seeds"][seed] = _cost_s(model, config, every, most)
            write_json(path, known)
    return [entry["seeds"][str(seed)]["cost_s"] for seed in range(seeds)]


def _cost_s(model: OffPolicyAlgorithm, config: RunConfig, every: int, most: int) -> dict[str, Any]:
    """Train a model until 95 % are held, and return what that cost with all that was seen on the way."""
    model.set_logger(Logger(None, []))
    found = _Evaluations(config.env, every, PolicyAverage(model, config.algorithm.policy_ema_half_life))
    model.learn(most, found, log_interval=10**9)
    cost = found.cost_s()
    curve = {"steps": found.steps, "success": found.rates, "cpu_s": [rounded(one) for one in found.cpu_s]}
    return {"cost_s": rounded(found.cpu_s[-1] if cost is None else cost), "reached": cost is not None, **curve}


def our_cost(config: RunConfig, every: int) -> dict[str, Any]:
    """Return the CPU time of a run's training to 95 %, as `peer_costs` counts it."""
    seeds = derive_seeds(config.seed)
    with torch_settings(config):
        env = make_training_envs(config.env, config.n_envs)
        model = build_model(config, env, seeds.policy)
        env.seed(seeds.training_scenes)
        return _cost_s(model, config, every, config.total_timesteps)


def costs(path: Path, seeds: int, *changes: str, whole: bool, **peer: int) -> dict[str, Any]:
    """Compare the CPU time to 95 % of the tutorial's recipe with the default one's: a ratio of medians over seeds.

    Args:
        path: where the peer's results are kept.
        seeds: how many, from 0 on.
        changes: overrides of the default recipe.
        whole: count our whole run, from the start of its process to the end, instead of training to 95 %; a seed that
            never holds 95 % has a ratio of 0 otherwise.
        peer: `every` and `most` of `peer_costs`.
    """
    peers = peer_costs(path, seeds, **peer)
    if whole:
        ours, rates = _whole_runs(seeds, *changes)
        known: dict[str, Any] = {"ours_success_rate": rates}
    else:
        configs = [run_config(f"seed={seed}", *changes) for seed in range(seeds)]
        trained = [our_cost(config, _every(config)) for config in configs]
        ours, known = [one["cost_s"] if one["reached"] else math.inf for one in trained], {}
    entry = spread([statistics.median(peers) / cost for cost in ours], "ratio")
    entry["ratio"] = rounded(statistics.median(peers) / statistics.median(ours))
    seconds = [rounded(cost) if math.isfinite(cost) else None for cost in ours]
    return entry | known | {"ours_cpu_s": seconds, "peer_cpu_s": peers, "peer": PEER, "unit": "CPU-seconds"}


def _whole_runs(seeds: int, *changes: str) -> tuple[list[float], list[float]]:
    """Return CPU time and success rate of whole runs, each in a process of its own."""
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
    """Return how many env steps make EVERY_UPDATES updates."""
    return max(1, round(EVERY_UPDATES / config.updates_per_step))


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

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

from parking_exp.algorithms.build import build_model, greedy_policy, torch_settings
from parking_exp.algorithms.policy_average import PolicyAverage
from parking_exp.benchmarks.timing import rounded, spread
from parking_exp.benchmarks.training import run_config, tutorial_model
from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import EnvConfig, RunConfig
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.evaluation.evaluate import evaluate, summarise
from parking_exp.runs.files import read_object, write_json
from parking_exp.runs.provenance import provenance
from parking_exp.statistics.survival import steps_to
from parking_exp.training.seeding import derive_seeds
from parking_exp.tuning.objectives import HOLD, THRESHOLD

PEER_FILE = "benchmark_peer.json"
N_SCENES = 200
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
    config = run_config("experiment=article", "torch_threads=1")
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
    found = _Evaluations(config.env, every, PolicyAverage(model, config.algorithm.averaged_policy))
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


def to_95(path: Path, seeds: int, *changes: str, **peer: int) -> dict[str, Any]:
    """Compare the CPU time to 95 % of the default recipe with the tutorial's: the ratio of their medians over seeds.

    A seed of ours that never holds 95 % has no cost, and a ratio of 0.

    Args:
        path: where the peer's results are kept.
        seeds: how many, from 0 on.
        changes: overrides of the default recipe.
        peer: `every` and `most` of `peer_costs`.
    """
    peers = peer_costs(path, seeds, **peer)
    configs = [run_config(f"seed={seed}", *changes) for seed in range(seeds)]
    ours = [our_cost(config, _every(config)) for config in configs]
    costs = [one["cost_s"] if one["reached"] else math.inf for one in ours]
    ratios = [statistics.median(peers) / cost for cost in costs]
    entry = spread(ratios, "ratio") | {"ratio": rounded(statistics.median(peers) / statistics.median(costs))}
    known = [cost if math.isfinite(cost) else None for cost in costs]
    return entry | {"ours_cpu_s": known, "peer_cpu_s": peers, "peer": PEER, "unit": "CPU-seconds to 95 %"}


def whole_run(path: Path, seeds: int, *changes: str, **peer: int) -> dict[str, Any]:
    """Compare the tutorial's CPU time to 95 % with a whole default run, from the start of its process to the end.

    The arguments are those of `to_95`. How often the runs park is given beside it.
    """
    theirs = statistics.median(peer_costs(path, seeds, **peer))
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
    entry = spread([theirs / cost for cost in costs], "ratio")
    known = {"ours_cpu_s": [rounded(cost) for cost in costs], "ours_success_rate": rates}
    return entry | known | {"peer": PEER, "unit": "CPU-seconds"}


def _every(config: RunConfig) -> int:
    """Return how many env steps make EVERY_UPDATES updates."""
    return max(1, round(EVERY_UPDATES / config.updates_per_step))


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

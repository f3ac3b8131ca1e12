#!/usr/bin/env python
"""Print how agents do on perturbed tasks, as a Markdown table of rates in percent over 500 scenes.

    python scripts/robustness.py [RUN ...]

A run is what `run=` of `scripts/evaluate.py` takes. For a folder of runs, the table has the mean
rates, and the lowest and highest rate of an agent. Without arguments these are `default`, `parked`
and `crowded` of the package. Each is evaluated on the env of its training, with 10 cars if it was
trained among cars. It has to reach its slot, or to stop in it where success requires that.
"""

import sys
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.cli.command import fail
from parking_exp.errors import ConfigError, ParkingError
from parking_exp.evaluation.agents import find_agents
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.task import Policy
from parking_exp.terminal import say

N_SCENES = 500
PRETRAINED_AGENTS = ["pretrained/default", "pretrained/parked", "pretrained/crowded"]


@dataclass(frozen=True)
class Perturbation:
    """A change of the task after training.

    Attributes:
        action: keys of `env.action`.
        vehicles_count: number of parked cars; none: 10 for an agent trained among cars, else 0.
        noise: standard deviation of what the agent measures of itself, in each step: position [m]
            and velocity [m/s], and a tenth of it in the cosine and sine of the heading.
        delay: policy steps, of 0.2 s, until an action has an effect.
        shift_m: the start is uniform within this distance in x, and half of it in y.
    """

    action: Mapping[str, Any] = field(default_factory=dict)
    vehicles_count: int | None = None
    noise: float = 0.0
    delay: int = 0
    shift_m: float = 0.0


PERTURBATIONS = {
    "none": Perturbation(),
    "start shifted by up to 8 m": Perturbation(shift_m=8),
    "start shifted by up to 16 m": Perturbation(shift_m=16),
    "steering up to 40° instead of 45°": Perturbation(
        {"steering_range": [-np.radians(40), np.radians(40)]}
    ),
    "steering up to 30°": Perturbation({"steering_range": [-np.radians(30), np.radians(30)]}),
    "acceleration up to 3 m/s² instead of 5": Perturbation({"acceleration_range": [-3.0, 3.0]}),
    "20 parked cars, seen only by `crowded`": Perturbation(vehicles_count=20),
    "noise of 0.1 m, 0.1 m/s, 0.6°": Perturbation(noise=0.1),
    "noise of 0.3 m, 0.3 m/s, 1.7°": Perturbation(noise=0.3),
    "actions 0.2 s late": Perturbation(delay=1),
    "actions 0.4 s late": Perturbation(delay=2),
}


def main() -> None:
    """Evaluate the agents of every argument on every perturbation."""
    runs = sys.argv[1:] or PRETRAINED_AGENTS
    if runs[0].startswith("-"):
        say(*str(__doc__).splitlines())
        return
    try:
        columns = [Column(run.removeprefix("run=")) for run in runs]
    except ParkingError as error:
        fail(error)
    headings = [f"`{column.name}`: {column.metric} (crash)" for column in columns]
    say(f"| perturbation | {' | '.join(headings)} |", f"|---|{'---:|' * len(columns)}")
    for title, perturbation in PERTURBATIONS.items():
        rates = [column.rates(perturbation) for column in columns]
        say(f"| {title} | {' | '.join(rates)} |")


class Column:
    """The agents of a run, or of a folder of runs."""

    def __init__(self, run: str) -> None:
        self.name = Path(run).name
        self.agents = []
        for agent in find_agents(run, Path("outputs")):
            if not isinstance(agent.config.env, ParkingConfig):
                raise ConfigError(f"{run} does not park")
            with closing(make_task(agent.config.env)) as task:
                self.agents.append((GreedyPolicy(agent.load(task)), agent.config.env))
        _, env = self.agents[0]
        weighs_velocity = any(env.reward_weights[2:4])
        self.metric = "parked" if weighs_velocity else "success"

    def rates(self, perturbation: Perturbation) -> str:
        """Return the mean rates of the agents in percent.

        For example `97.2 (0.8)`, or of several agents `97.2, 95.0 to 99.4 (0.8)`.
        """
        shares = []
        for policy, env in self.agents:
            shares.append(evaluate(policy, _perturb(env, perturbation), perturbation))
        rates = 100 * np.array([share[self.metric] for share in shares])
        crash = 100 * np.mean([share["crash"] for share in shares])
        rate = f"{rates.mean():.1f}"
        if len(rates) > 1:
            rate += f", {rates.min():.1f} to {rates.max():.1f}"
        return f"{rate} ({crash:.1f})"


def _perturb(env: ParkingConfig, perturbation: Perturbation) -> ParkingConfig:
    cars = perturbation.vehicles_count
    if cars is None:
        cars = 10 if env.vehicles_range[1] else 0
    action = env.action.model_copy(update=dict(perturbation.action))
    return env.model_copy(update={"action": action, "vehicles_count": cars})


def evaluate(policy: Policy, config: ParkingConfig, perturbation: Perturbation) -> dict[str, float]:
    """Return the rates of success, crash and parked over scenes 0 to 499."""
    rng = np.random.default_rng(0)
    scenes = lot_of(config).from_seeds(range(N_SCENES))
    simulator = Simulator(config, scenes)
    shift = perturbation.shift_m * np.array([[1.0], [0.5]])
    simulator.state.position[:] += rng.uniform(-shift, shift, (2, N_SCENES))
    waiting = [np.zeros((N_SCENES, 2), np.float32)] * perturbation.delay
    # In the scales of the observation.
    sigma = perturbation.noise / np.array([100, 100, 5, 5, 10, 10])
    counts = {"success": 0, "crash": 0, "parked": 0}
    under_way = np.ones(N_SCENES, bool)
    while under_way.any():
        observation = simulator.observe()
        noise = rng.normal(0, sigma, (N_SCENES, 6))
        observation["achieved_goal"] += noise
        observation["observation"][:, :6] += noise
        waiting.append(policy(observation))
        step = simulator.step(waiting.pop(0))
        ended = under_way & (step.terminated | step.truncated)
        counts["crash"] += int((ended & step.failed).sum())
        counts["success"] += int((ended & step.is_success & ~step.failed).sum())
        for row in np.flatnonzero(ended):
            counts["parked"] += simulator.ending(int(row)).parked
        under_way &= ~ended
    return {name: count / N_SCENES for name, count in counts.items()}


if __name__ == "__main__":
    main()

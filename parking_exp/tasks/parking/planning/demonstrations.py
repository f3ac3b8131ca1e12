"""Episodes in which the planner drives."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.planning.planner import Planner
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.task import Observation


@dataclass(frozen=True)
class Demonstration:
    """An episode that the planner has driven.

    Attributes:
        observations: by key, from the start to the end, each of shape (steps + 1, size).
        actions: shape (steps, 2).
        is_success: whether the car is parked at the end.
    """

    observations: Observation
    actions: np.ndarray
    is_success: bool


def demonstrate(planner: Planner, seeds: Sequence[int]) -> list[Demonstration]:
    """Plan and drive the scenes of some seeds, one after the other, in the vectorized simulator."""
    return [_drive(planner, seed) for seed in seeds]


def _drive(planner: Planner, seed: int) -> Demonstration:
    config = planner.task.config
    simulator = Simulator(config, lot_of(config).from_seeds([seed]))
    planner.start([seed])
    observations = [simulator.observe()]
    actions = []
    done = np.array([False])
    while not done[0]:
        actions.append(planner(observations[-1]))
        step = simulator.step(actions[-1])
        observations.append(step.observation)
        done = step.terminated | step.truncated
    return Demonstration(
        observations={
            key: np.concatenate([observation[key] for observation in observations])
            for key in observations[0]
        },
        actions=np.concatenate(actions),
        is_success=bool(step.is_success[0]),
    )

"""Record episodes of the simulator: where the car was, and how it was driven."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.metrics import outcome
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.scene_shapes import scene_shapes
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.rollout import rollout
from parking_exp.tasks.task import Observation, Policy

MOTION = ("x", "y", "heading", "speed", "acceleration", "steering")
"""Columns of `RecordedEpisode.motion`, in m, rad, m/s and m/s²."""


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode from its start to its end."""

    seed: int
    outcome: str
    # At the start, see `scene_shapes`; parked cars that are pushed later stay there.
    shapes: dict[str, np.ndarray]
    # At the start and after each policy step, shape (1 + steps, MOTION). Acceleration and steering
    # are those that the policy asked for in the step before; 0 at the start.
    motion: np.ndarray
    # What a lidar measures at the same times, shape (1 + steps, rays) [m]. The rays are evenly
    # spaced, the first straight ahead, the others counter-clockwise. There may be none.
    rays: np.ndarray


def record_episodes(
    policy: Policy, config: ParkingConfig, seeds: Sequence[int]
) -> list[RecordedEpisode]:
    """Drive the scenes of some seeds to their ends, in the vectorized simulator.

    As in an evaluation, the policy sees the scenes in one batch, without those that have ended.
    """
    starts = lot_of(config).from_seeds(seeds)
    shapes = [scene_shapes(starts, row, walls=config.add_walls) for row in range(len(seeds))]
    simulator = Simulator(config, starts)
    outcomes = [""] * len(seeds)
    history = [_record_step(simulator, np.zeros((2, len(seeds))), simulator.observe())]
    recorded = [np.arange(len(seeds))]
    for scenes, actions, step in rollout(policy, simulator, seeds):
        history.append(_record_step(simulator, simulator.controls(actions), step.observation))
        recorded.append(scenes)
        for row in np.flatnonzero(step.terminated | step.truncated):
            ending = outcome("crash", bool(step.failed[row]), bool(step.is_success[row]))
            outcomes[scenes[row]] = ending

    records = _split_by_scene(np.concatenate(history), np.concatenate(recorded))
    episodes = []
    for seed, ending, scene, record in zip(seeds, outcomes, shapes, records, strict=True):
        motion, rays = np.split(record, [len(MOTION)], axis=1)
        episodes.append(RecordedEpisode(seed, ending, scene, motion, rays))
    return episodes


def _record_step(
    simulator: Simulator, controls: np.ndarray, observation: Observation
) -> np.ndarray:
    """Return what is recorded of a step: motion, then rays, shape (n, MOTION + rays)."""
    state = simulator.state
    motion = np.stack([*state.position, state.heading, state.speed, *controls], axis=1)
    observed = observation["observation"]
    seen = observed[:, observed.shape[1] - simulator.rays :]  # the last entries
    return np.concatenate([motion, simulator.rays_range_m * seen], axis=1)


def _split_by_scene(rows: np.ndarray, scenes: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each scene in their order; scenes are numbers from 0, shape (rows,)."""
    in_order = rows[np.argsort(scenes, kind="stable")]
    ends = np.cumsum(np.bincount(scenes))
    return np.split(in_order, ends[:-1])

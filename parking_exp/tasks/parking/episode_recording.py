"""Record episodes of the simulator: where the car was, and how it was driven."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.metrics import outcome
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.scene_shapes import SceneShapes, scene_shapes
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.task import Policy

MOTION = ("x", "y", "heading", "speed", "acceleration", "steering")
"""Columns of `RecordedEpisode.motion`, in m, rad, m/s and m/s²."""


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode from its start to its end."""

    seed: int
    outcome: str
    shapes: SceneShapes  # at the start; parked cars that are pushed later stay there
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
    scenes = np.arange(len(seeds))
    history = [_motion(simulator, np.zeros((2, len(seeds))))]
    recorded = [scenes]
    observation = simulator.observe()
    while len(simulator):
        actions = policy(observation)
        step = simulator.step(actions)
        history.append(_motion(simulator, simulator.controls(actions)))
        recorded.append(scenes)

        done = step.terminated | step.truncated
        for row in np.flatnonzero(done):
            ending = outcome("crash", bool(step.failed[row]), bool(step.is_success[row]))
            outcomes[scenes[row]] = ending
        simulator.keep(~done)
        scenes = scenes[~done]
        observation = {key: values[~done] for key, values in step.observation.items()}

    motions = _split_by_scene(np.concatenate(history), np.concatenate(recorded))
    episodes = []
    for seed, ending, scene, motion in zip(seeds, outcomes, shapes, motions, strict=True):
        rays = np.empty((len(motion), 0))
        episodes.append(RecordedEpisode(seed, ending, scene, motion, rays))
    return episodes


def _motion(simulator: Simulator, controls: np.ndarray) -> np.ndarray:
    """Return what is recorded of a step, shape (n, MOTION)."""
    state = simulator.state
    return np.stack([*state.position, state.heading, state.speed, *controls], axis=1)


def _split_by_scene(rows: np.ndarray, scenes: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each scene in their order; scenes are numbers from 0, shape (rows,)."""
    in_order = rows[np.argsort(scenes, kind="stable")]
    ends = np.cumsum(np.bincount(scenes))
    return np.split(in_order, ends[:-1])

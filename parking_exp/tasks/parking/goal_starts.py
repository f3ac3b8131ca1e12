"""Starts of training episodes that are reached by driving out of the goal (reverse curriculum)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from parking_exp.tasks.parking.free_space import FreeSpace
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M
from parking_exp.tasks.parking.lot import Lot, lot_of
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.scenes import Scenes
from parking_exp.tasks.parking.simulator.dynamics import slip_angle

SHARES = {"goal": 1.0, "mixed": 0.5}  # of the scenes that start so, by `env.starts`
MOST_ARCS = 20
MOST_ARC_M = 8.0
N_POINTS = 80  # of an arc, where contacts are looked for: at most 0.1 m apart
MARGIN_M = 0.05  # kept there, so that nothing is touched between two points
N_DRAWS = 3 + 2 * MOST_ARCS


class GoalStarts:
    """A lot whose scenes start where a car gets that drives out of its goal at random.

    The way out is a path back into the goal, so every start can be solved. See Florensa et al.
    (2017), "Reverse Curriculum Generation for Reinforcement Learning".

    The car stands in the goal and drives 1 to `MOST_ARCS` arcs, alternately ahead and in reverse.
    It steers as far as it can to one side or the other, or not at all. An arc is up to `MOST_ARC_M`
    long, and ends before the car comes closer than `MARGIN_M` to something.

    A scene takes `N_DRAWS` numbers, uniform in [0, 1). They choose whether it starts so at all, the
    number of arcs and the first direction, then steering and length of each arc. Those of seed s
    are `Generator(PCG64(SeedSequence(s)).jumped(3)).random(N_DRAWS)`.

    Args:
        config: the env's config; `starts` is a key of `SHARES`.
    """

    def __init__(self, config: ParkingConfig) -> None:
        self.lot: Lot = lot_of(config)
        self.share = SHARES[config.starts]
        self.walls = config.add_walls
        _, (low, high) = config.action.ranges
        self.slips = slip_angle(np.array([low, np.clip(0.0, low, high), high]))

    def from_seeds(self, seeds: Sequence[int]) -> Scenes:
        """Return the scenes of some seeds."""
        draws = np.empty((len(seeds), N_DRAWS))
        for row, seed in enumerate(seeds):
            bit_generator = np.random.PCG64(np.random.SeedSequence(int(seed)))
            draws[row] = np.random.Generator(bit_generator.jumped(3)).random(N_DRAWS)
        return self.with_starts(self.lot.from_seeds(seeds), draws)

    def random(self, rng: np.random.Generator, n: int) -> Scenes:
        """Sample scenes of the same distribution, many at once."""
        scenes = self.lot.random(rng, n)
        return self.with_starts(scenes, rng.random((n, N_DRAWS)))

    def with_starts(self, scenes: Scenes, draws: np.ndarray) -> Scenes:
        """Return scenes with other starts, from numbers in [0, 1), shape (n, N_DRAWS)."""
        is_moved = draws[:, 0] < self.share
        n_arcs = 1 + (draws[:, 1] * MOST_ARCS).astype(np.int64)
        first_direction = np.where(draws[:, 2] < 0.5, -1.0, 1.0)
        choice = (draws[:, 3::2] * len(self.slips)).astype(np.int64)
        length_m = draws[:, 4::2] * MOST_ARC_M
        fractions = np.linspace(0.0, 1.0, N_POINTS + 1)
        rows = np.arange(len(scenes))

        space = FreeSpace(scenes, walls=self.walls, margin_m=MARGIN_M)
        pose = scenes.goal_pose
        for arc in range(n_arcs.max(initial=0)):
            direction = first_direction * (-1.0) ** arc
            driven = (direction * length_m[:, arc])[:, None] * fractions
            path = drive(pose[:, None], self.slips[choice[:, arc], None], driven)
            ends = space.touches(path[:, 1:])
            ends[arc >= n_arcs] = True
            # The point before the first contact.
            last = np.where(ends.any(axis=1), ends.argmax(axis=1), N_POINTS)
            pose = path[rows, last]
        return replace(scenes, start=np.where(is_moved[:, None], pose, scenes.start))


def drive(pose: np.ndarray, slip: np.ndarray, length_m: np.ndarray) -> np.ndarray:
    """Return where a car gets on an arc, shape (..., 3) [m, m, rad].

    Args:
        pose: the pose from which it drives, shape (..., 3) [m, m, rad].
        slip: `slip_angle` of its steering, shape (...) [rad].
        length_m: the length of the arc of its middle, negative in reverse, shape (...).
    """
    turn = length_m * np.sin(slip) / (CAR_LENGTH_M / 2)
    chord = length_m * np.sinc(turn / (2 * np.pi))
    course = pose[..., 2] + slip + turn / 2
    x = pose[..., 0] + chord * np.cos(course)
    y = pose[..., 1] + chord * np.sin(course)
    return np.stack([x, y, pose[..., 2] + turn], axis=-1)

"""highway-env's own lot: its scenes, bit for bit, and many random ones at once.

A scene is the car's heading in the middle of the lot, its goal slot, slots of parked cars and
places of obstacles.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from parking_exp.tasks.parking.geometry import (
    LOT_LENGTH_M,
    LOT_WIDTH_M,
    N_SLOTS,
    ROW_Y_M,
    SLOT_HEADINGS,
    SLOT_LENGTH_M,
    SLOT_POSES,
    SLOT_POSITIONS,
    SLOT_WIDTH_M,
    SLOTS_PER_ROW,
)
from parking_exp.tasks.parking.scenes import MOST_SCENES, NO_SLOT, Scenes, scene_rng

# Half the length and width of the area: within the walls, outside of the slots.
AISLE_M = np.array([33.0, 8.5])
# Distance of obstacles from the middle of the lot, where the car starts.
CLEARANCE_M = 6.0

# In each row, one slot is the first of those nearest to the origin. These are its number
# and heading, and its distance from the origin as highway-env adds it up.
_START_SLOTS = tuple(
    int(row + np.argmin(np.abs(SLOT_POSITIONS[row : row + SLOTS_PER_ROW, 0])))
    for row in (0, SLOTS_PER_ROW)
)
_START_HEADINGS = SLOT_HEADINGS[list(_START_SLOTS), None]
_START_DISTANCE_M = abs(float(SLOT_POSITIONS[_START_SLOTS[0], 0])) + 10.0

# The geometry of any number of scenes of highway-env's lot: views, which take no memory.
_ALL_SLOTS = np.broadcast_to(SLOT_POSES, (MOST_SCENES, *SLOT_POSES.shape))
_ALL_SLOT_SIZES = np.broadcast_to((SLOT_LENGTH_M, SLOT_WIDTH_M), (MOST_SCENES, 2))
_ALL_BOXES = np.broadcast_to((LOT_LENGTH_M, LOT_WIDTH_M), (MOST_SCENES, 2))


@dataclass(frozen=True)
class HighwayLot:
    """highway-env's own lot: 28 slots in two rows, 70 x 42 m.

    Attributes:
        vehicles_range: the lowest and the highest number of parked cars, at most 26; see
            `sample_vehicles_count`.
        n_obstacles: the number of obstacles; see `obstacles_of_scene`.

    The other attributes are described at `lot.Lot`.
    """

    vehicles_range: tuple[int, int]
    n_obstacles: int
    nearest_row_m = ROW_Y_M
    size_m = (LOT_LENGTH_M, LOT_WIDTH_M)
    same_walls = True
    is_turn_symmetric = True
    handed = False

    def from_seeds(self, seeds: Sequence[int]) -> Scenes:
        """Return the scenes of `env.reset(seed=s)` of highway-env, bit for bit."""
        heading = np.empty(len(seeds))
        n_cars = np.empty(len(seeds), np.int64)
        slots = np.zeros((len(seeds), 1 + self.vehicles_range[1]), np.int64)
        obstacles = np.empty((len(seeds), self.n_obstacles, 2))
        for row, seed in enumerate(seeds):
            rng = scene_rng(seed)
            n_cars[row] = sample_vehicles_count(rng.bit_generator, *self.vehicles_range)
            if self.n_obstacles:
                obstacles[row] = obstacles_of_scene(rng.bit_generator, self.n_obstacles)
            heading[row] = 2.0 * np.pi * rng.uniform()
            # highway-env calls `Generator.choice`, which draws as `integers` does.
            draws = [rng.integers(N_SLOTS - 1 - taken) for taken in range(1 + n_cars[row])]
            slots[row, : len(draws)] = draws
        return _from_draws(heading, slots, n_cars, obstacles)

    def random(self, rng: np.random.Generator, n: int) -> Scenes:
        """Sample scenes of the same distribution, many at once."""
        low, high = self.vehicles_range
        heading = 2.0 * np.pi * rng.uniform(size=n)
        slots = rng.integers(N_SLOTS - 1 - np.arange(1 + high), size=(n, 1 + high))
        n_cars = rng.integers(low, high + 1, n) if low < high else np.full(n, high)
        obstacles = sample_places(rng, n * self.n_obstacles).reshape(n, self.n_obstacles, 2)
        return _from_draws(heading, slots, n_cars, obstacles)

    def typical(self) -> Scenes:
        """Return one scene, for drawings of the lot."""
        return self.from_seeds([0])


def _from_draws(
    heading: np.ndarray, draws: np.ndarray, n_cars: np.ndarray, obstacles: np.ndarray
) -> Scenes:
    """Return the scenes of drawn numbers.

    Args:
        heading: headings of the car at the start, shape (n,) [rad].
        draws: numbers of slots among those still free, the goal's first, shape (n, 1 + vehicles).
        n_cars: how many of the parked cars each scene has, shape (n,).
        obstacles: places of obstacles, shape (n, obstacles, 2) [m].
    """
    taken = np.empty((len(draws), 1 + draws.shape[1]), np.int64)
    taken[:, 0] = start_slot(heading)
    for column in range(draws.shape[1]):
        slot = draws[:, column].copy()
        for occupied in np.sort(taken[:, : column + 1], axis=1).T:
            slot += slot >= occupied
        taken[:, column + 1] = slot
    vehicles = taken[:, 2:]
    vehicles[np.arange(vehicles.shape[1]) >= n_cars[:, None]] = NO_SLOT
    n = len(heading)
    start = np.zeros((n, 3))
    start[:, 2] = heading
    return Scenes(
        start=start,
        goal=taken[:, 1],
        vehicles=vehicles,
        obstacles=obstacles,
        slots=_ALL_SLOTS[:n],
        slot_size=_ALL_SLOT_SIZES[:n],
        box=_ALL_BOXES[:n],
    )


def start_slot(heading: np.ndarray) -> np.ndarray:
    """Return the slot that highway-env takes for the start, which is never a goal; shape (n,).

    It minimises distance plus difference of heading. Of the two slots at each heading, highway-env
    takes the first.
    """
    turn = heading - _START_HEADINGS
    turn += np.pi
    turn %= 2 * np.pi
    turn -= np.pi
    above, below = _START_DISTANCE_M + np.abs(turn)
    return np.where(above <= below, *_START_SLOTS)


def sample_vehicles_count(bit_generator: Any, low: int, high: int) -> int:
    """Sample a scene's number of vehicles, uniform from low to high.

    A copy of the scene's generator, jumped once, samples the number: `env.reset(seed=s)` has
    `Generator(PCG64(SeedSequence(s)).jumped()).integers(low, high + 1)` vehicles.
    """
    if low == high:
        return low
    return int(np.random.Generator(bit_generator.jumped()).integers(low, high + 1))


def sample_places(rng: np.random.Generator, n: int) -> np.ndarray:
    """Sample n obstacles' places, shape (n, 2) [m], uniform in the aisle but not at the start."""
    places = np.empty((0, 2))
    while len(places) < n:
        candidates = rng.uniform(-AISLE_M, AISLE_M, (n, 2))
        distance = np.sqrt((candidates**2).sum(axis=1))
        places = np.concatenate([places, candidates[distance > CLEARANCE_M]])
    return places[:n]


def obstacles_of_scene(bit_generator: Any, n: int) -> np.ndarray:
    """Return the places of a scene's obstacles, without using up its random generator.

    They are sampled by that generator, jumped twice: `env.reset(seed=s)` has
    `sample_places(Generator(PCG64(SeedSequence(s)).jumped(2)), n)`.
    """
    return sample_places(np.random.Generator(bit_generator.jumped(2)), n)

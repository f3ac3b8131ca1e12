"""Lots other than highway-env's, parametric ones and several in one; the lot of a config."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from parking_exp.tasks.parking.geometry import WALL_THICKNESS_M
from parking_exp.tasks.parking.highway_lot import HighwayLot
from parking_exp.tasks.parking.lot_config import (
    DIMENSIONS,
    GAP_M,
    SMALLEST,
    LotConfig,
    LotDimensions,
    bounds,
)
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.scenes import NO_SLOT, Scenes, scene_rng

# Every scene draws the first three of the `LotDimensions`, before all else. It draws the others
# last, and only those that are ranges, so that lots without such ranges keep their scenes.
N_FIRST = 3


class SampledLot(ABC):
    """A lot whose scenes are made from `n_draws` numbers, uniform in [0, 1).

    The numbers of `env.reset(seed=s)` are
    `gymnasium.utils.seeding.np_random(s)[0].random(n_draws)`.
    """

    n_draws: int

    @abstractmethod
    def scenes(self, draws: np.ndarray) -> Scenes:
        """Return the scenes of numbers in [0, 1), shape (n, n_draws)."""

    def from_seeds(self, seeds: Sequence[int]) -> Scenes:
        """Return the scenes of `env.reset(seed=s)`."""
        draws = np.empty((len(seeds), self.n_draws))
        for row, seed in enumerate(seeds):
            draws[row] = scene_rng(seed).random(self.n_draws)
        return self.scenes(draws)

    def random(self, rng: np.random.Generator, n: int) -> Scenes:
        """Sample scenes of the same distribution, many at once."""
        return self.scenes(rng.random((n, self.n_draws)))


class ParametricLot(SampledLot):
    """Rows of slots along an aisle; see `LotConfig`.

    The numbers of a scene choose, in this order:

    - length and width of the slots, width of the aisle
    - x, y and heading of the start
    - the goal, then the number of parked cars
    - one for each slot: cars take the slots in the order of these numbers, lowest first
    - angle, pitch and end of the aisle, where they are ranges

    Args:
        config: the geometry of the lot.
        vehicles_range: the lowest and the highest number of parked cars.
    """

    def __init__(self, config: LotConfig, vehicles_range: tuple[int, int]) -> None:
        self.config = config
        self.vehicles_range = vehicles_range
        self.is_turn_symmetric = config.is_turn_symmetric
        self.handed = config.handed
        lowest, highest = config.ranges
        is_range = lowest < highest
        is_range[:N_FIRST] = False
        self._sampled_last = np.flatnonzero(is_range)  # columns of `LotDimensions`
        n_of_parts = (N_FIRST, 3, 2, config.n_slots, len(self._sampled_last))
        self._part_ends = np.cumsum(n_of_parts)
        self.n_draws = int(self._part_ends[-1])
        starts = config.starts
        self._starts = np.array([starts.x_m, starts.y_m, np.radians(starts.heading_deg)]).T
        self._goals = np.arange(config.n_slots)
        if config.neighbours == "taken":
            last = config.slots_per_row - 1
            in_row = self._goals % config.slots_per_row
            self._goals = self._goals[(in_row > 0) & (in_row < last)]
        slots, boxes, _ = self._geometry(config.extremes())
        length, width = boxes.max(axis=0).tolist()
        self.size_m = (length, width)
        self.same_walls = bool((boxes == boxes[0]).all())
        self.nearest_row_m = float(np.abs(slots[..., 1]).min()) - SMALLEST

    def typical(self) -> Scenes:
        """Return one scene, with the middle of all ranges, for drawings of the lot."""
        return self.scenes(np.full((1, self.n_draws), 0.5))

    def scenes(self, draws: np.ndarray) -> Scenes:
        """Return the scenes of numbers in [0, 1), shape (n, n_draws)."""
        n = len(draws)
        parts = np.split(draws, self._part_ends[:-1], axis=1)
        first, starts, goal_and_n_cars, priorities, sampled_last = parts
        shares = np.zeros((n, len(DIMENSIONS)))
        shares[:, :N_FIRST] = first
        shares[:, self._sampled_last] = sampled_last
        dimensions = self.config.dimensions(shares)
        slots, box, middle = self._geometry(dimensions)

        lowest, highest = self._starts
        start = lowest + starts * (highest - lowest)
        start[:, :2] += middle
        goal = self._goals[(goal_and_n_cars[:, 0] * len(self._goals)).astype(np.int64)]
        low, high = self.vehicles_range
        n_cars = low + (goal_and_n_cars[:, 1] * (high - low + 1)).astype(np.int64)
        return Scenes(
            start=start,
            goal=goal,
            vehicles=self._choose_taken_slots(priorities, goal, n_cars),
            obstacles=np.zeros((n, 0, 2)),
            slots=slots,
            slot_size=np.stack([dimensions.slot_length_m, dimensions.slot_width_m], axis=1),
            box=box,
        )

    def _geometry(self, dimensions: LotDimensions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the poses of the slots, shape (n, slots, 3), the size of the box, and the middle
        of the aisle in it, both of shape (n, 2).

        The middle of the box is the origin.
        """
        config = self.config
        aisle = dimensions.aisle_width_m
        cos, sin = dimensions.direction
        depth = dimensions.slot_length_m * sin + dimensions.slot_width_m * cos
        left, right = config.ends_m(dimensions)
        above = aisle / 2 + depth + GAP_M
        below = above if config.rows == 2 else aisle / 2
        middle = np.stack([left - right, below - above], axis=1) / 2
        box = np.stack([left + right, above + below], axis=1) + WALL_THICKNESS_M

        in_row = np.arange(config.slots_per_row) - (config.slots_per_row - 1) / 2
        x = dimensions.sampled_pitch_m[:, None] * in_row
        y = np.repeat(((aisle + depth) / 2)[:, None], config.slots_per_row, axis=1)
        if config.rows == 2:
            # The row below is the one above, turned by 180 degrees.
            x = np.concatenate([x, -x], axis=1)
            y = np.concatenate([y, -y], axis=1)
        slots = np.empty((*x.shape, 3))
        slots[..., 0] = x + middle[:, :1]
        slots[..., 1] = y + middle[:, 1:]
        slots[..., 2] = np.radians(dimensions.angle_deg)[:, None]
        slots[:, config.slots_per_row :, 2] += np.pi
        if config.heading == "out":
            slots[..., 2] += np.pi
        return slots, box, middle

    def _choose_taken_slots(
        self, priorities: np.ndarray, goal: np.ndarray, n_cars: np.ndarray
    ) -> np.ndarray:
        """Return the slots of parked cars, shape (n, most cars), NO_SLOT beyond `n_cars`."""
        priorities = priorities.copy()
        rows = np.arange(len(priorities))
        if self.config.neighbours == "taken":
            priorities[rows, goal - 1] = -2.0
            priorities[rows, goal + 1] = -1.0
        priorities[rows, goal] = 1.0
        taken = np.argsort(priorities, axis=1, kind="stable")[:, : self.vehicles_range[1]]
        taken[np.arange(taken.shape[1]) >= n_cars[:, None]] = NO_SLOT
        return taken


class SeveralLots(SampledLot):
    """Several lots, on one of which each scene is.

    The first number of a scene chooses the lot. That lot makes the scene from the other numbers.
    """

    def __init__(self, lots: Sequence[ParametricLot]) -> None:
        self.lots = lots
        self.n_draws = 1 + max(lot.n_draws for lot in lots)
        self.n_slots = max(lot.config.n_slots for lot in lots)
        fewest = min(lot.vehicles_range[0] for lot in lots)
        most = max(lot.vehicles_range[1] for lot in lots)
        self.vehicles_range = (fewest, most)
        self.nearest_row_m = min(lot.nearest_row_m for lot in lots)
        length = max(lot.size_m[0] for lot in lots)
        width = max(lot.size_m[1] for lot in lots)
        self.size_m = (length, width)
        self.same_walls = False
        self.is_turn_symmetric = all(lot.is_turn_symmetric for lot in lots)
        self.handed = any(lot.handed for lot in lots)

    def scenes(self, draws: np.ndarray) -> Scenes:
        """Return the scenes of numbers in [0, 1), shape (n, n_draws)."""
        lot_index = (draws[:, 0] * len(self.lots)).astype(np.int64)
        parts = []
        for index, lot in enumerate(self.lots):
            lot_draws = draws[lot_index == index, 1 : 1 + lot.n_draws]
            parts.append(self._pad(lot.scenes(lot_draws)))
        # From the order of the lots back to the order of the scenes.
        scene_order = np.argsort(np.argsort(lot_index, kind="stable"))
        arrays = {}
        for name in vars(parts[0]):
            by_lot = np.concatenate([getattr(part, name) for part in parts])
            arrays[name] = by_lot[scene_order]
        return Scenes(**arrays)

    def _pad(self, scenes: Scenes) -> Scenes:
        """Pad scenes to as many slots and parked cars as the largest lot has.

        The last slot is repeated. Cars that are missing are NO_SLOT.
        """
        n, n_slots, _ = scenes.slots.shape
        _, most = self.vehicles_range
        slot = np.minimum(np.arange(self.n_slots), n_slots - 1)
        vehicles = np.full((n, most), NO_SLOT)
        vehicles[:, : scenes.vehicles.shape[1]] = scenes.vehicles
        return replace(scenes, slots=scenes.slots[:, slot], vehicles=vehicles)


Lot = HighwayLot | ParametricLot | SeveralLots
"""Where scenes take place. All lots have `from_seeds`, `random`, and these attributes:

vehicles_range: the lowest and the highest number of parked cars.
size_m: length and width of the largest box.
nearest_row_m: lower bound of the distance in y from the middle of the lot to a slot's centre.
same_walls: whether all scenes have the same walls.
is_turn_symmetric: whether the lot equals itself when it is turned by 180 degrees.
handed: whether it differs from its mirror image.
"""


def lot_of(config: ParkingConfig) -> Lot:
    """Return the lot of an `env` group; several lots are combined into one."""
    return combine_lots(config.lot_configs.values(), config.vehicles_count, config.obstacles)


def combine_lots(configs: Iterable[LotConfig], vehicles_count: Any, n_obstacles: int = 0) -> Lot:
    """Combine the lots of some configs into one; without configs, return highway-env's lot.

    `vehicles_count` and `n_obstacles` are the env's.
    """
    lots = [ParametricLot(config, config.vehicles_range(vehicles_count)) for config in configs]
    if not lots:
        return HighwayLot(bounds(vehicles_count), n_obstacles)
    if len(lots) == 1:
        return lots[0]
    return SeveralLots(lots)

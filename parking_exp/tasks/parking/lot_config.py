"""The `env.lot` section: the geometry of a lot other than highway-env's own."""

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from parking_exp.config_model import Bounds, ConfigModel
from parking_exp.tasks.parking.geometry import (
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    Lengths,
    direction_of,
    extent,
)

TINY = 1e-9
MAX_M = 1000.0
GAP_M = 0.5  # from the slots to the wall behind them, and beside the last one of a dead end


def bounds(value: Any) -> tuple[Any, Any]:
    """Return the lowest and the highest value of a number or a range, a list of two."""
    if isinstance(value, list) and len(value) == 2:
        low, high = value
        return low, high
    return value, value


def _check_drawn(value: Any) -> float | list[float]:
    """Return a length, or the lowest and the highest of those that scenes draw."""
    low, high = bounds(value)
    numbers = {type(low), type(high)} <= {int, float}
    if not (numbers and 0 < low <= high <= MAX_M):
        raise ValueError("give a length in metres, or the lowest and the highest: [6, 7]")
    return [float(low), float(high)] if isinstance(value, list) else float(value)


def _check_order(value: list[float]) -> list[float]:
    if value[0] > value[1]:
        raise ValueError("the lowest number comes first")
    return value


def _check_vehicles_count(value: Any) -> Any:
    """Refuse what is neither a number of cars nor a range."""
    low, high = bounds(value)
    if not (type(low) is type(high) is int and 0 <= low <= high):
        raise ValueError("give a number of cars, or the lowest and the highest: [0, 20]")
    return value


def _is_missing(value: Any) -> bool:
    return value is None


Metres = Annotated[float, Field(gt=0, le=MAX_M)]
Drawn = Annotated[Any, AfterValidator(_check_drawn)]
Ordered = Annotated[Bounds, AfterValidator(_check_order)]
VehiclesCount = Annotated[Any, AfterValidator(_check_vehicles_count)]


class StartsConfig(ConfigModel):
    """Where the car starts, each uniform in its range.

    x is relative to the middle of the rows, y to the middle of the aisle.
    """

    x_m: Ordered
    y_m: Ordered
    heading_deg: Ordered


class LotConfig(ConfigModel):
    """Rows of equal slots along an aisle, in a box of four walls.

    Length and width of the slots and width of the aisle are numbers, or ranges from which each
    scene draws its own.
    """

    angle_deg: Annotated[float, Field(ge=0, le=90)]  # of the slots to the aisle
    slot_length_m: Drawn
    slot_width_m: Drawn
    aisle_width_m: Drawn
    # From slot to slot along the aisle; None: side by side.
    pitch_m: Metres | None = None
    slots_per_row: Annotated[int, Field(ge=1, le=100)]
    rows: Literal[1, 2]
    end_m: Annotated[float, Field(ge=0, le=1000)]  # of the aisle, beyond the rows
    dead_end: bool
    heading: Literal["in", "out"]
    neighbours: Literal["any", "taken"]
    starts: StartsConfig
    # None: that of the env. Left out of stored configs then.
    vehicles_count: Annotated[VehiclesCount, Field(exclude_if=_is_missing)] = None

    @property
    def n_slots(self) -> int:
        """Number of slots."""
        return self.rows * self.slots_per_row

    @property
    def turned(self) -> bool:
        """Whether the lot equals itself when it is turned by 180 degrees."""
        return self.rows == 2 and not self.dead_end

    @property
    def handed(self) -> bool:
        """Whether walls and slots differ when they are mirrored, x to -x."""
        return self.dead_end or self.angle_deg not in (0, 90)

    def vehicles_range(self, of_env: Any) -> tuple[int, int]:
        """Return the lowest and the highest number of parked cars of a scene.

        `of_env` is the `vehicles_count` of the env, for a lot that has none.
        """
        if self.vehicles_count is None:
            return bounds(of_env)
        return bounds(self.vehicles_count)

    def closest_pitch_m(self, slot_length_m: Lengths, slot_width_m: Lengths) -> np.ndarray:
        """Return the smallest distances along the aisle at which slots of some sizes do not
        overlap.
        """
        angle = math.radians(self.angle_deg)
        side_by_side = slot_width_m / max(math.sin(angle), TINY)
        one_behind_the_other = slot_length_m / max(math.cos(angle), TINY)
        return np.minimum(side_by_side, one_behind_the_other)

    def drawn_pitch_m(self, slot_length_m: Lengths, slot_width_m: Lengths) -> np.ndarray:
        """Return the distances from slot to slot along the aisle, for slots of some sizes."""
        closest = self.closest_pitch_m(slot_length_m, slot_width_m)
        if self.pitch_m is None:
            return closest
        return np.full_like(closest, self.pitch_m)

    def half_row_m(self, slot_length_m: Lengths, slot_width_m: Lengths) -> np.ndarray:
        """Return half the lengths of rows of slots of some sizes."""
        angle = np.radians(self.angle_deg)
        slot = slot_length_m * np.cos(angle) + slot_width_m * np.sin(angle)
        pitch = self.drawn_pitch_m(slot_length_m, slot_width_m)
        half: np.ndarray = (slot + (self.slots_per_row - 1) * pitch) / 2
        return half

    def problems(self, key: str, vehicles: tuple[int, int], *, walls: bool) -> Iterator[str]:
        """Yield a sentence for each reason why there can't be such a lot.

        Args:
            key: of the section that describes the lot, such as `env.lot`.
            vehicles: the lowest and the highest number of parked cars.
            walls: whether there are walls around the lot.
        """
        yield from self._slot_problems(key)
        yield from self._start_problems(key, walls)
        yield from self._vehicle_problems(key, vehicles)

    def _slot_problems(self, key: str) -> Iterator[str]:
        sides = (("slot_length_m", CAR_LENGTH_M, "long"), ("slot_width_m", CAR_WIDTH_M, "wide"))
        for side, car_m, word in sides:
            lowest, _ = bounds(getattr(self, side))
            if lowest <= car_m:
                yield f"{key}.{side}={lowest:g}: the car is {car_m:g} m {word}"
        _, length = bounds(self.slot_length_m)
        _, width = bounds(self.slot_width_m)
        needed = float(self.closest_pitch_m(length, width))
        if self.pitch_m is not None and self.pitch_m < needed - TINY:
            yield f"{key}.pitch_m={self.pitch_m:g}: slots overlap below {needed:.3g} m"

    def _start_problems(self, key: str, walls: bool) -> Iterator[str]:
        starts = self.starts
        low, high = starts.heading_deg
        headings = np.radians(np.linspace(low, high, 1001))
        # How far a car may reach at its start from its centre, along and across the aisle.
        along, across = extent(direction_of(headings)).max(axis=1).tolist()
        aisle, _ = bounds(self.aisle_width_m)
        farthest = max(map(abs, starts.y_m)) + across
        if farthest >= aisle / 2:
            yield (
                f"{key}.aisle_width_m={aisle:g}: cars that start within "
                f"{key}.starts need {2 * farthest:.3g} m"
            )
        right = GAP_M if self.dead_end else self.end_m
        length, _ = bounds(self.slot_length_m)
        width, _ = bounds(self.slot_width_m)
        half_row = float(self.half_row_m(length, width))
        ends = (-half_row - self.end_m, half_row + right)
        outside = starts.x_m[0] - along <= ends[0] or starts.x_m[1] + along >= ends[1]
        if walls and outside:
            yield (
                f"{key}.starts.x_m={starts.x_m}: cars would start in the walls, which are at "
                f"{ends[0]:.3g} and {ends[1]:.3g} m"
            )

    def _vehicle_problems(self, key: str, vehicles: tuple[int, int]) -> Iterator[str]:
        low, high = vehicles
        count = f"{key}.vehicles_count"
        if self.vehicles_count is None:
            count = "env.vehicles_count"
        if high >= self.n_slots:
            yield f"{count}={high}: {key} has {self.n_slots} slots, and one is the goal"
        if self.neighbours == "taken" and low < 2:
            yield f"{count}={low}: {key}.neighbours=taken needs two cars or more"
        if self.neighbours == "taken" and self.slots_per_row < 3:
            yield f"{key}.slots_per_row: {key}.neighbours=taken needs three slots or more"

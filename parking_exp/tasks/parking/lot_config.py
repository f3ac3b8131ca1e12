"""The `env.lot` section: the geometry of a lot other than highway-env's own."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from parking_exp.config_model import Bounds, ConfigModel, left_out
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, CAR_WIDTH_M, direction_of, extent

SMALLEST = 1e-9  # lengths and differences below it count as 0
MAX_M = 1000.0
MAX_SHARE = float(np.nextafter(1.0, 0.0))  # the largest number that a generator returns
GAP_M = 0.5  # from the slots to the wall behind them, and beside the last one of a dead end


def bounds(value: Any) -> tuple[Any, Any]:
    """Return the lowest and the highest value of a number or a range, a list of two."""
    if isinstance(value, list) and len(value) == 2:
        low, high = value
        return low, high
    return value, value


def _sampled(lowest: float, highest: float, sentence: str) -> AfterValidator:
    """Return a validator of a number or a range [lowest, highest] that scenes sample from."""

    def check(value: Any) -> float | list[float]:
        low, high = bounds(value)
        are_numbers = {type(low), type(high)} <= {int, float}
        if not (are_numbers and lowest <= low <= high <= highest):
            raise ValueError(sentence)
        return [float(low), float(high)] if isinstance(value, list) else float(value)

    return AfterValidator(check)


def _check_order(value: list[float]) -> list[float]:
    if value[0] > value[1]:
        raise ValueError("a range is [lowest, highest]")
    return value


def _check_vehicles_count(value: Any) -> Any:
    """Refuse what is neither a number of cars nor a range."""
    low, high = bounds(value)
    if not (type(low) is int and type(high) is int and 0 <= low <= high):
        raise ValueError("give a number of cars, or the lowest and the highest: [0, 20]")
    return value


LENGTH = "give a length of at most 1000 m, or the lowest and the highest: [6, 7]"
END = "give a length from 0 to 1000 m, or the lowest and the highest: [6, 7]"
ANGLE = "give an angle from 0 to 90 degrees, or the lowest and the highest: [45, 90]"

Length = Annotated[Any, _sampled(SMALLEST, MAX_M, LENGTH)]
End = Annotated[Any, _sampled(0.0, MAX_M, END)]
Angle = Annotated[Any, _sampled(0.0, 90.0, ANGLE)]
Ordered = Annotated[Bounds, AfterValidator(_check_order)]
VehiclesCount = Annotated[Any, AfterValidator(_check_vehicles_count)]


class StartsConfig(ConfigModel):
    """Where the car starts, each uniform in its range.

    x is relative to the middle of the rows, y to the middle of the aisle.
    """

    x_m: Ordered
    y_m: Ordered
    heading_deg: Ordered


@dataclass(frozen=True)
class LotDimensions:
    """The dimensions that n scenes sample of their lot, each of shape (n,) [m, degrees].

    They have the names of their keys, and the order in which they are sampled. The docs call them
    the numbers of a lot.
    """

    slot_length_m: np.ndarray
    slot_width_m: np.ndarray
    aisle_width_m: np.ndarray
    angle_deg: np.ndarray
    pitch_m: np.ndarray  # NaN: as close as they fit
    end_m: np.ndarray

    @property
    def direction(self) -> np.ndarray:
        """Cosine and sine of the slots' angles to the aisle, shape (2, n)."""
        return direction_of(np.radians(self.angle_deg))

    @property
    def closest_pitch_m(self) -> np.ndarray:
        """The smallest distances along the aisle at which slots do not overlap, shape (n,)."""
        cos, sin = np.maximum(self.direction, SMALLEST)
        side_by_side = self.slot_width_m / sin
        one_behind_the_other = self.slot_length_m / cos
        return np.minimum(side_by_side, one_behind_the_other)

    @property
    def sampled_pitch_m(self) -> np.ndarray:
        """The distances from slot to slot along the aisle, shape (n,)."""
        return np.where(np.isnan(self.pitch_m), self.closest_pitch_m, self.pitch_m)


DIMENSIONS = tuple(field.name for field in fields(LotDimensions))


class LotConfig(ConfigModel):
    """Rows of equal slots along an aisle, in a box of four walls.

    The keys of `LotDimensions` may be ranges, from which each scene samples its own dimensions.
    """

    angle_deg: Angle  # between the slots and the aisle
    slot_length_m: Length
    slot_width_m: Length
    aisle_width_m: Length
    # From slot to slot along the aisle; None: as close as they fit.
    pitch_m: Length | None = None
    slots_per_row: Annotated[int, Field(ge=1, le=100)]
    rows: Literal[1, 2]
    end_m: End  # length of the aisle beyond the rows
    dead_end: bool
    heading: Literal["in", "out"]
    neighbours: Literal["any", "taken"]
    starts: StartsConfig
    vehicles_count: VehiclesCount = left_out(None)  # None: the env's own number

    @property
    def n_slots(self) -> int:
        """Number of slots."""
        return self.rows * self.slots_per_row

    @property
    def is_turn_symmetric(self) -> bool:
        """Whether the lot equals itself when it is turned by 180 degrees."""
        return self.rows == 2 and not self.dead_end

    @property
    def handed(self) -> bool:
        """Whether walls and slots differ when they are mirrored, x to -x."""
        return self.dead_end or bounds(self.angle_deg) not in ((0, 0), (90, 90))

    @property
    def ranges(self) -> np.ndarray:
        """The lowest and the highest of each of the `LotDimensions`, shape (2, 6)."""
        ranges = [bounds(getattr(self, name)) for name in DIMENSIONS]
        return np.array(ranges, dtype=np.float64).T

    def vehicles_range(self, env_count: Any) -> tuple[int, int]:
        """Return the lowest and the highest number of parked cars of a scene.

        `env_count` is the `vehicles_count` of the env, for a lot that has none.
        """
        if self.vehicles_count is None:
            return bounds(env_count)
        return bounds(self.vehicles_count)

    def dimensions(self, shares: np.ndarray) -> LotDimensions:
        """Return the dimensions of n scenes.

        Args:
            shares: their places in their ranges, from 0 (lowest) to 1 (highest). Shape (n, 6), or
                (n, 1) if all dimensions have the same place.
        """
        low, high = self.ranges
        dimensions = low + shares * (high - low)
        return LotDimensions(*dimensions.T)

    def extremes(self) -> LotDimensions:
        """Return dimensions of lots among which are the smallest and the largest."""
        _, length = bounds(self.slot_length_m)
        _, width = bounds(self.slot_width_m)
        diagonal = np.degrees(np.arctan2(width, length))
        # Rows and the closest pitch are longest where a diagonal of the slots is along the aisle.
        # Slots are deepest where a diagonal is across. Away from these angles, all three shrink, so
        # each is smallest at an end of the range. All three grow with every other dimension.
        angles = np.clip([0.0, diagonal, 90.0 - diagonal, 90.0], *bounds(self.angle_deg))
        shares = np.repeat([0.0, MAX_SHARE], len(angles))
        dimensions = self.dimensions(shares[:, None])
        return replace(dimensions, angle_deg=np.tile(angles, 2))

    def ends_m(self, dimensions: LotDimensions) -> np.ndarray:
        """Return how far the aisle goes left and right of the middle of its rows, shape (2, n)."""
        cos, sin = dimensions.direction
        slot = dimensions.slot_length_m * cos + dimensions.slot_width_m * sin
        half_row = (slot + (self.slots_per_row - 1) * dimensions.sampled_pitch_m) / 2
        ends = half_row + np.array([dimensions.end_m, dimensions.end_m])
        if self.dead_end:
            ends[1] = half_row + GAP_M
        return ends

    def problems(self, key: str, vehicles: tuple[int, int], *, walls: bool) -> Iterator[str]:
        """Yield a sentence for each reason why there can't be such a lot.

        Args:
            key: the key of the section that describes the lot, such as `env.lot`.
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
        pitch, _ = bounds(self.pitch_m)
        needed = self.extremes().closest_pitch_m.max()
        if pitch is not None and pitch < needed - SMALLEST:
            yield f"{key}.pitch_m={pitch:g}: slots overlap below {needed:.3g} m"

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
        left, right = self.ends_m(self.extremes()).min(axis=1)
        outside = starts.x_m[0] - along <= -left or starts.x_m[1] + along >= right
        if walls and outside:
            yield (
                f"{key}.starts.x_m={starts.x_m}: cars would start in the walls, which are at "
                f"{-left:.3g} and {right:.3g} m"
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

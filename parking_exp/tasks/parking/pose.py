"""Final pose of the car, and the definition of parked."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.parking.geometry import (
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    in_frame,
)

PARKED_HEADING_RAD = math.radians(10.0)
PARKED_SPEED_MPS = 0.5


@dataclass(frozen=True)
class PoseInSlot:
    """The car relative to its goal slot."""

    ahead_m: float  # position of the car's centre in the slot's frame
    side_m: float
    heading_error_rad: float  # in [-pi, pi)
    speed_mps: float  # signed
    parked: bool  # see `is_parked`

    @property
    def distance_m(self) -> float:
        """Distance from the car's centre to the slot's."""
        return math.hypot(self.ahead_m, self.side_m)


Numbers = np.ndarray | float


def is_parked(
    ahead_m: Numbers,
    side_m: Numbers,
    heading_error_rad: Numbers,
    speed_mps: Numbers,
    slot_length_m: Numbers,
    slot_width_m: Numbers,
) -> Numbers:
    """Return whether all corners are inside the slot's lines, heading within 10°, under 0.5 m/s.

    This is stricter than highway-env's success on parking-v0, which allows 1.44 m, 33 degrees or
    any speed. Position and heading are relative to the slot; numbers, or arrays of one shape.
    """
    cos = np.abs(np.cos(heading_error_rad))
    sin = np.abs(np.sin(heading_error_rad))
    half_length = (CAR_LENGTH_M * cos + CAR_WIDTH_M * sin) / 2
    half_width = (CAR_LENGTH_M * sin + CAR_WIDTH_M * cos) / 2
    inside = np.abs(ahead_m) + half_length <= slot_length_m / 2
    inside &= np.abs(side_m) + half_width <= slot_width_m / 2
    straight = np.abs(heading_error_rad) <= PARKED_HEADING_RAD
    stationary = np.abs(speed_mps) < PARKED_SPEED_MPS
    parked: Numbers = inside & straight & stationary
    return parked


def pose_in_slot(
    position: np.ndarray,
    heading: float,
    speed: float,
    goal_position: np.ndarray,
    goal_heading: float,
    slot_size: Sequence[float] | np.ndarray,
) -> PoseInSlot:
    """Return the pose of a car relative to its goal slot.

    Positions are (x, y), the slot's size is its length and width; each has the shape (2,).
    """
    direction = (math.cos(goal_heading), math.sin(goal_heading))
    ahead, side = in_frame(position - goal_position, direction)
    error = (heading - goal_heading + math.pi) % (2 * math.pi) - math.pi
    return PoseInSlot(
        ahead_m=float(ahead),
        side_m=float(side),
        heading_error_rad=float(error),
        speed_mps=float(speed),
        parked=bool(is_parked(ahead, side, error, speed, *slot_size)),
    )

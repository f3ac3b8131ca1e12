"""Final pose of the car, and the definition of parked."""

import math
from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.parking.geometry import (
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    SLOT_LENGTH_M,
    SLOT_WIDTH_M,
)

PARKED_HEADING_RAD = math.radians(10.0)
PARKED_SPEED_MPS = 0.5


@dataclass(frozen=True)
class Pose:
    """The car relative to its goal slot."""

    ahead_m: float  # of the car's centre, in the slot's frame
    side_m: float
    heading_error_rad: float  # in [-pi, pi)
    speed_mps: float  # signed

    @property
    def distance_m(self) -> float:
        """Distance from the car's centre to the slot's."""
        return math.hypot(self.ahead_m, self.side_m)

    @property
    def parked(self) -> bool:
        """Whether all four corners are inside the slot's lines, heading within 10 degrees, speed
        below 0.5 m/s.

        Stricter than highway-env's success, which allows 1.44 m, 33 degrees or any speed.
        """
        cos = abs(math.cos(self.heading_error_rad))
        sin = abs(math.sin(self.heading_error_rad))
        half_length = (CAR_LENGTH_M * cos + CAR_WIDTH_M * sin) / 2
        half_width = (CAR_LENGTH_M * sin + CAR_WIDTH_M * cos) / 2
        return (
            abs(self.ahead_m) + half_length <= SLOT_LENGTH_M / 2
            and abs(self.side_m) + half_width <= SLOT_WIDTH_M / 2
            and abs(self.heading_error_rad) <= PARKED_HEADING_RAD
            and abs(self.speed_mps) < PARKED_SPEED_MPS
        )


def relative_pose(
    position: np.ndarray,
    heading: float,
    speed: float,
    goal_position: np.ndarray,
    goal_heading: float,
) -> Pose:
    """Return the pose of a car relative to its goal slot; positions are (x, y), shape (2,)."""
    dx, dy = position - goal_position
    cos = math.cos(goal_heading)
    sin = math.sin(goal_heading)
    error = (heading - goal_heading + math.pi) % (2 * math.pi) - math.pi
    return Pose(
        ahead_m=float(dx * cos + dy * sin),
        side_m=float(dy * cos - dx * sin),
        heading_error_rad=float(error),
        speed_mps=float(speed),
    )

"""Follow trajectories with highway-env's car."""

import numpy as np

from parking_exp.tasks.parking.driven_path import REAR_AXLE_M
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, direction_of, in_frame

SETTLING_M = 1.0  # the way on which errors across the path and of the heading settle
GAIN = 0.5  # share of an error along the path that is corrected in a step


def follow(
    poses: np.ndarray, references: np.ndarray, sharpest: float, dt: float, frames: int
) -> np.ndarray:
    """Return acceleration [m/s2] and steering angle [rad] of cars, shape (n, 2).

    Feedforward drives the rear axle along its trajectory. Feedback corrects its distance from it,
    with the gains of a critically damped oscillator.

    Args:
        poses: x, y, vx, vy, cos_h and sin_h of the cars, shape (n, 6) [m, m/s].
        references: rows of their trajectories, shape (n, REFERENCE).
        sharpest: the largest curvature that the rear axle can have [1/m].
        dt: length of a frame of the simulation [s].
        frames: the number of frames of a policy step.
    """
    position, velocity, direction = np.split(poses.T, 3)
    ref_heading, _, next_speed, curvature, forward = references.T[2:]
    speed, _ = in_frame(velocity, direction)
    # A frame moves the car in the direction at its beginning, so not the rear axle moves along the
    # heading, but a point before or behind it.
    rear = REAR_AXLE_M - speed * dt / 2
    ref_direction = direction_of(ref_heading)
    behind = references.T[:2] - (position - rear * direction)
    along, across = in_frame(behind, ref_direction)
    cos_turned, sin_turned = in_frame(direction, ref_direction)
    turned = np.arctan2(sin_turned, cos_turned)

    curvature = curvature + across / SETTLING_M**2 - 2 * forward * turned / SETTLING_M
    curvature = np.clip(curvature, -sharpest, sharpest)
    steering = np.arctan(CAR_LENGTH_M * curvature)

    # The simulator's speed is that of the centre, which is farther from the centre of the turn.
    longer = np.hypot(1.0, REAR_AXLE_M * curvature)
    step_s = dt * frames
    target = next_speed * longer + GAIN * along / step_s
    acceleration = (target - speed) / step_s
    return np.stack([acceleration, steering], axis=1)

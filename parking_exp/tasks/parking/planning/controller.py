"""Follow trajectories with highway-env's car."""

import numpy as np

from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, REAR_AXLE_M, direction_of, in_frame

SETTLING_M = 1.0  # the way on which errors across the path and of the heading settle
GAIN = 0.5  # share of an error along the path that is corrected in a step


def follow(
    poses: np.ndarray, references: np.ndarray, max_curvature: float, dt: float, frames_per_step: int
) -> np.ndarray:
    """Return acceleration [m/s2] and steering angle [rad] of cars, shape (n, 2).

    Feedforward drives the rear axle along its trajectory. Feedback corrects its distance from it,
    with the gains of a critically damped oscillator.

    Args:
        poses: x, y, vx, vy, cos_h and sin_h of the cars, shape (n, 6) [m, m/s].
        references: rows of their trajectories, shape (n, REFERENCE).
        max_curvature: the largest curvature that the rear axle can have [1/m].
        dt: length of a frame of the simulation [s].
        frames_per_step: the number of frames of a policy step.
    """
    position, velocity, direction = np.split(poses.T, 3)
    ref_heading, _, next_speed, curvature, forward = references.T[2:]
    speed, _ = in_frame(velocity, direction)
    # A frame moves the car in its direction at the start of the frame. So the point that moves
    # along the heading is not the rear axle, but a point before or behind it.
    rear = REAR_AXLE_M - speed * dt / 2
    ref_direction = direction_of(ref_heading)
    position_error = references.T[:2] - (position - rear * direction)
    along_error, across_error = in_frame(position_error, ref_direction)
    cos_error, sin_error = in_frame(direction, ref_direction)
    heading_error = np.arctan2(sin_error, cos_error)

    across_feedback = across_error / SETTLING_M**2
    heading_feedback = -2 * forward * heading_error / SETTLING_M
    curvature = curvature + across_feedback + heading_feedback
    curvature = np.clip(curvature, -max_curvature, max_curvature)
    steering = np.arctan(CAR_LENGTH_M * curvature)

    # The simulator's speed is the speed of the car's centre, which is farther from the centre of
    # the turn.
    centre_speed_ratio = np.hypot(1.0, REAR_AXLE_M * curvature)
    step_s = dt * frames_per_step
    target_speed = next_speed * centre_speed_ratio + GAIN * along_error / step_s
    acceleration = (target_speed - speed) / step_s
    return np.stack([acceleration, steering], axis=1)

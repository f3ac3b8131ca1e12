"""Vehicle dynamics of highway-env's car, a kinematic bicycle model, for arrays of cars.

Operations and their order are the same as in `Vehicle.step` and `ContinuousAction`, so that results
agree to the last bit. Positions are in metres, headings and steering angles in radians, speeds in
m/s.
"""

import numpy as np

from parking_exp.tasks.parking.geometry import CAR_LENGTH_M

Limits = tuple[float, float]


def slip_angle(steering: np.ndarray) -> np.ndarray:
    """Return the angle between the direction of motion at the car's centre and its heading."""
    return np.arctan(0.5 * np.tan(steering))


def advance(
    position: np.ndarray,
    heading: np.ndarray,
    speed: np.ndarray,
    gain: np.ndarray,
    slip: np.ndarray,
    sin_slip: np.ndarray,
    dt: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Integrate the bicycle model over a simulation frame; return position, heading and speed.

    Args:
        position: shape (2, n); all others have the shape (n,).
        gain: acceleration times dt.
        slip, sin_slip: `slip_angle` of the steering, and its sine.
        dt: length of the frame [s].
    """
    course = heading + slip
    new_position = np.empty_like(position)
    np.cos(course, out=new_position[0])
    np.sin(course, out=new_position[1])
    new_position *= speed
    new_position *= dt
    new_position += position
    new_heading = speed * sin_slip
    new_heading /= CAR_LENGTH_M / 2
    new_heading *= dt
    new_heading += heading
    return new_position, new_heading, speed + gain


def limited_acceleration(
    acceleration: np.ndarray, speed: np.ndarray, speed_range: Limits
) -> np.ndarray:
    """Return the acceleration after highway-env's speed limiter: a car that is too fast is slowed
    down, not stopped.
    """
    low, high = speed_range
    limited = np.where(speed > high, np.minimum(acceleration, high - speed), acceleration)
    return np.where(speed < low, np.maximum(acceleration, low - speed), limited)

"""Trajectories: paths with a speed at each time."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.parking.geometry import direction_of, in_frame

STEP_M = 0.5  # the longest way between two actions

REFERENCE = ("x", "y", "heading", "speed", "next_speed", "curvature", "forward")
"""Columns of a trajectory: pose [m, m, rad] and signed speed [m/s] of the rear axle at a step; its
speed at the next step; its curvature [1/m] and the direction of motion, 1 or -1, until then.
"""


@dataclass(frozen=True)
class Pace:
    """How fast a path is driven."""

    step_s: float  # length of a policy step
    speed_mps: float
    acceleration_mps2: float


def make_trajectory(path: np.ndarray, pace: Pace) -> np.ndarray:
    """Return what the rear axle should do on a path at each policy step, shape (steps, REFERENCE).

    The car stops where the path changes its direction, and at its end.

    Args:
        path: poses, shape (n, 3) [m, m, rad].
        pace: the highest speed and acceleration.
    """
    parts = []
    if len(path) > 1:
        parts = [_drive_part(poses, forward, pace) for poses, forward in _split_by_direction(path)]
    x, y, heading = path[-1]
    parts.append(np.array([[x, y, heading, 0.0, 0.0, 0.0, 1.0]]))  # stand
    return np.concatenate(parts)


def _split_by_direction(path: np.ndarray) -> Iterator[tuple[np.ndarray, float]]:
    """Yield the parts of a path without a change of direction, and the direction of each."""
    way = np.diff(path[:, :2], axis=0)
    heading = (path[:-1, 2] + path[1:, 2]) / 2
    ahead, _ = in_frame(way.T, direction_of(heading))
    forward = np.where(ahead >= 0, 1.0, -1.0)
    changes = np.flatnonzero(np.diff(forward)) + 1
    firsts = [0, *changes.tolist()]
    lasts = [*changes.tolist(), len(way)]
    for first, last in zip(firsts, lasts, strict=True):
        yield path[first : last + 1], float(forward[first])


def _drive_part(poses: np.ndarray, forward: float, pace: Pace) -> np.ndarray:
    """Return the trajectory of a part in one direction, from standstill to standstill."""
    steps_m = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    distance = np.concatenate([[0.0], np.cumsum(steps_m)])
    speed = _plan_speeds(distance[-1], pace)
    covered = (speed[:-1] + speed[1:]) / 2 * pace.step_s
    reached = np.concatenate([[0.0], np.cumsum(covered)])

    part = np.full((len(reached), len(REFERENCE)), forward)
    for column, values in enumerate(poses.T):
        part[:, column] = np.interp(reached, distance, values)
    turned = np.diff(part[:, 2])
    part[:, 3] = forward * speed
    part[:-1, 4] = forward * speed[1:]
    part[:-1, 5] = forward * turned / np.maximum(np.diff(reached), 1e-9)
    return part[:-1]


def _plan_speeds(distance: float, pace: Pace) -> np.ndarray:
    """Return speeds at policy steps that cover a distance, the first and the last of them 0."""
    fastest = min(pace.speed_mps, STEP_M / pace.step_s)
    n = 2
    while True:
        steps = np.arange(n + 1)
        speed = pace.acceleration_mps2 * pace.step_s * np.minimum(steps, n - steps)
        speed = np.minimum(speed, fastest)
        covered = speed.sum() * pace.step_s
        if covered >= distance:
            return speed * (distance / covered)
        n += 1

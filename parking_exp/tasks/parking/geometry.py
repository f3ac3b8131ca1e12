"""Geometry of highway-env's parking lot and of what is in it, in metres and radians."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

CAR_LENGTH_M, CAR_WIDTH_M = 5.0, 2.0
CAR_SIZE_M = (CAR_LENGTH_M, CAR_WIDTH_M)
CAR_DIAGONAL_M = float(np.sqrt(CAR_LENGTH_M**2 + CAR_WIDTH_M**2))
REAR_AXLE_M = CAR_LENGTH_M / 2  # behind the middle of highway-env's car
SLOT_LENGTH_M, SLOT_WIDTH_M = 8.0, 4.0
LOT_LENGTH_M, LOT_WIDTH_M = 70.0, 42.0  # between the centre lines of the walls
WALL_THICKNESS_M = 1.0

SLOTS_PER_ROW = 14
_ROW_X = np.array(
    [(k + 1 - SLOTS_PER_ROW // 2) * SLOT_WIDTH_M - SLOT_WIDTH_M / 2 for k in range(SLOTS_PER_ROW)]
)
ROW_Y_M = 14.0

# In highway-env's order: the row above from left to right, then the row below.
SLOT_POSITIONS = np.stack(
    [np.concatenate([_ROW_X, _ROW_X]), np.repeat([ROW_Y_M, -ROW_Y_M], SLOTS_PER_ROW)], axis=-1
)  # (28, 2) centres [m]
# (28,) [rad].
SLOT_HEADINGS = np.repeat(np.arctan2([SLOT_LENGTH_M, -SLOT_LENGTH_M], [0.0, 0.0]), SLOTS_PER_ROW)
N_SLOTS = len(SLOT_HEADINGS)
SLOT_POSES = np.concatenate([SLOT_POSITIONS, SLOT_HEADINGS[:, None]], axis=1)  # (28, 3)

# The walls are the sides of a box around the origin, in highway-env's order: below, above, left,
# right. Each is a rectangle, one metre thick. WALL_SIDES are their directions from the origin.
# WALL_ALONG is 0 for a wall along the length of the box, and 1 for a wall along its width.
WALL_SIDES = np.array([[0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [1.0, 0.0]])
WALL_HEADINGS = np.array([0.0, 0.0, np.pi / 2, np.pi / 2])
WALL_ALONG = np.array([0, 0, 1, 1])
N_WALLS = len(WALL_ALONG)

OBSTACLE_M = 2.0  # highway-env's obstacles are squares
OBSTACLE_SIZE_M = (OBSTACLE_M, OBSTACLE_M)

TINY_M = 1e-6  # far above the rounding of positions

# Where the corners of a rectangle are, as shares of its length and its width.
ALONG = np.array([-0.5, -0.5, 0.5, 0.5])
ACROSS = np.array([-0.5, 0.5, 0.5, -0.5])

Lengths = np.ndarray | float
Vectors = np.ndarray | tuple[np.ndarray, np.ndarray]


def corners(
    position: np.ndarray, direction: np.ndarray, length: Lengths, width: Lengths
) -> np.ndarray:
    """Return the corners of rectangles, in order around them, shape (..., 4, 2) [m].

    Args:
        position: centres, shape (..., 2).
        direction: cosine and sine of the headings, shape (..., 2).
        length: along the heading, one for all or shape (...) [m].
        width: across it, likewise.
    """
    points = np.empty((*np.shape(length), 4, 2))
    np.multiply.outer(length, ALONG, out=points[..., 0])
    np.multiply.outer(width, ACROSS, out=points[..., 1])
    rotation = np.empty((*direction.shape, 2))
    rotation[..., 0] = direction
    rotation[..., 1, 1] = direction[..., 0]
    np.negative(direction[..., 1], out=rotation[..., 0, 1])
    rotated = (rotation @ points.swapaxes(-1, -2)).swapaxes(-1, -2)
    return np.add(rotated, position[..., None, :], order="C")


def extent(direction: np.ndarray, margin_m: float = 0.0) -> np.ndarray:
    """Return how far cars, with a margin around them, reach from their centres along x and y.

    `direction` and the result have the shape (2, ...).
    """
    share = np.abs(direction)
    reach: np.ndarray = share * (CAR_LENGTH_M / 2 + margin_m)
    reach += share[::-1] * (CAR_WIDTH_M / 2 + margin_m)
    return reach


def may_overlap(
    offset: np.ndarray,
    direction: np.ndarray,
    half_size: np.ndarray,
    other_direction: np.ndarray,
    other_half_size: np.ndarray,
) -> np.ndarray:
    """Return a mask of pairs of rectangles that are less than `TINY_M` apart along each side.

    All arguments have a shape that broadcasts to (2, ...), where the mask has the shape (...).

    Args:
        offset: the vector from the first centre to the second [m].
        direction, other_direction: cosine and sine of their headings.
        half_size, other_half_size: half their lengths and widths [m].
    """
    turn = np.abs(in_frame(other_direction, direction))
    apart = np.abs(in_frame(offset, direction)) - half_size
    apart -= turn * other_half_size[0] + turn[::-1] * other_half_size[1]
    other_apart = np.abs(in_frame(offset, other_direction)) - other_half_size
    other_apart -= turn * half_size[0] + turn[::-1] * half_size[1]
    mask: np.ndarray = np.maximum(apart, other_apart).max(axis=0) < TINY_M
    return mask


def direction_of(heading: np.ndarray) -> np.ndarray:
    """Return the cosine and the sine of headings, shape (2, ...)."""
    direction = np.empty((2, *heading.shape))
    np.cos(heading, out=direction[0])
    np.sin(heading, out=direction[1])
    return direction


def in_frame(vector: Vectors, direction: Vectors | tuple[float, float]) -> np.ndarray:
    """Return vectors along and across some directions, all of shape (2, ...)."""
    x, y = vector
    cos, sin = direction
    return np.array([x * cos + y * sin, y * cos - x * sin])


def move_ahead(poses: np.ndarray, distance_m: float) -> np.ndarray:
    """Return poses that are moved along their headings, shape (..., 3) [m, m, rad]."""
    heading = poses[..., 2]
    moved = poses.copy()
    moved[..., 0] += distance_m * np.cos(heading)
    moved[..., 1] += distance_m * np.sin(heading)
    return moved


@dataclass(frozen=True)
class Rectangles:
    """Rectangles with a direction, in arrays of any shape."""

    centre: np.ndarray  # shape (..., 2) [m]
    heading: np.ndarray  # shape (...) [rad]
    size: np.ndarray  # length along the heading and width across it, shape (..., 2) [m]

    @property
    def diagonal(self) -> np.ndarray:
        """Their diagonals, shape (...) [m]."""
        length = self.size[..., 0]
        width = self.size[..., 1]
        diagonal: np.ndarray = np.sqrt(length**2 + width**2)
        return diagonal


def cars_at(position: np.ndarray, heading: np.ndarray) -> Rectangles:
    """Return cars; positions have the shape (..., 2), headings (...)."""
    size = np.broadcast_to(CAR_SIZE_M, position.shape)
    return Rectangles(position, heading, size)


def obstacles_at(places: np.ndarray) -> Rectangles:
    """Return obstacles; places have the shape (..., 2)."""
    size = np.broadcast_to(OBSTACLE_SIZE_M, places.shape)
    return Rectangles(places, np.zeros(places.shape[:-1]), size)


def walls_around(free: np.ndarray) -> Rectangles:
    """Return the walls of n scenes, of shape (n, 4).

    `free` is half the space between their inner faces, shape (2, n) [m].
    """
    half = free.T[:, None] + WALL_THICKNESS_M / 2
    size = np.empty((len(half), N_WALLS, 2))
    size[..., 0] = 2 * half[:, 0, WALL_ALONG]
    size[..., 1] = WALL_THICKNESS_M
    heading = np.broadcast_to(WALL_HEADINGS, size.shape[:2])
    return Rectangles(half * WALL_SIDES, heading, size)


def join_rectangles(parts: Sequence[Rectangles]) -> Rectangles:
    """Return some scenes' rectangles as one, shape (n, R); the parts are (n, their number)."""
    return Rectangles(
        centre=np.concatenate([part.centre for part in parts], axis=1),
        heading=np.concatenate([part.heading for part in parts], axis=1),
        size=np.concatenate([part.size for part in parts], axis=1),
    )

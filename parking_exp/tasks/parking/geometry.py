"""Geometry of highway-env's parking lot and of the cars in it, in metres and radians."""

import numpy as np

CAR_LENGTH_M, CAR_WIDTH_M = 5.0, 2.0
CAR_DIAGONAL_M = float(np.sqrt(CAR_LENGTH_M**2 + CAR_WIDTH_M**2))
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
# right. Each is a rectangle, one metre thick. These are their centres, in halves of the box; their
# headings; and whether they are as long as the length of the box (0) or as its width (1).
WALL_SIDES = np.array([[0.0, -1.0], [0.0, 1.0], [-1.0, 0.0], [1.0, 0.0]])
WALL_HEADINGS = np.array([0.0, 0.0, np.pi / 2, np.pi / 2])
WALL_ALONG = np.array([0, 0, 1, 1])
N_WALLS = len(WALL_ALONG)

OBSTACLE_M = 2.0  # of highway-env's obstacles, which are squares
OBSTACLE_DIAGONAL_M = float(np.sqrt(2 * OBSTACLE_M**2))

# Of the corners of a rectangle, in its length and its width.
ALONG = np.array([-0.5, -0.5, 0.5, 0.5])
ACROSS = np.array([-0.5, 0.5, 0.5, -0.5])

Lengths = np.ndarray | float


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

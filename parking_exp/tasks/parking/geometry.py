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
_ROW_Y = 14.0

# In highway-env's order: the row above from left to right, then the row below.
SLOT_POSITIONS = np.stack(
    [np.concatenate([_ROW_X, _ROW_X]), np.repeat([_ROW_Y, -_ROW_Y], SLOTS_PER_ROW)], axis=-1
)  # (28, 2) centres [m]
# (28,) [rad].
SLOT_HEADINGS = np.repeat(np.arctan2([SLOT_LENGTH_M, -SLOT_LENGTH_M], [0.0, 0.0]), SLOTS_PER_ROW)
N_SLOTS = len(SLOT_HEADINGS)

# In highway-env's order: below, above, left, right. Each is a rectangle: centre, heading, length;
# one metre thick.
WALL_POSITIONS = np.array(
    [
        [0.0, -LOT_WIDTH_M / 2],
        [0.0, LOT_WIDTH_M / 2],
        [-LOT_LENGTH_M / 2, 0.0],
        [LOT_LENGTH_M / 2, 0.0],
    ]
)
WALL_HEADINGS = np.array([0.0, 0.0, np.pi / 2, np.pi / 2])
WALL_LENGTHS = np.array([LOT_LENGTH_M, LOT_LENGTH_M, LOT_WIDTH_M, LOT_WIDTH_M])
WALL_DIAGONALS = np.sqrt(WALL_LENGTHS**2 + WALL_THICKNESS_M**2)

OBSTACLE_M = 2.0  # of highway-env's obstacles, which are squares
OBSTACLE_DIAGONAL_M = float(np.sqrt(2 * OBSTACLE_M**2))

"""Who touches whom in a frame, in highway-env's order, and what follows from it."""

import numpy as np

from parking_exp.envs.collisions import corners, out_of_reach, separating_axis
from parking_exp.envs.state import State
from parking_exp.lot import (
    CAR_DIAGONAL_M,
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    WALL_DIAGONALS,
    WALL_HEADINGS,
    WALL_LENGTHS,
    WALL_POSITIONS,
    WALL_THICKNESS_M,
)

WALL_SIDES = np.array([1, 3, 0, 2])  # of the directions left, below, right, above
WALL_DISTANCES = np.linalg.norm(WALL_POSITIONS, axis=1) - WALL_THICKNESS_M / 2


class Contacts:
    """Finds the collisions of scenes.

    Args:
        dt: length of a frame [s].
        count: parked cars in each scene.
        walls: whether there are walls.
    """

    def __init__(self, dt: float, count: int, *, walls: bool) -> None:
        self.dt, self.walls = dt, walls
        self._lengths = np.append(np.full(1 + count, CAR_LENGTH_M), WALL_LENGTHS)
        self._widths = np.append(np.full(1 + count, CAR_WIDTH_M), np.full(len(WALL_LENGTHS), WALL_THICKNESS_M))
        self._diagonals = np.append(np.full(1 + count, CAR_DIAGONAL_M), WALL_DIAGONALS)
        things = 1 + count + len(WALL_LENGTHS) * walls
        pairs = [(first, second) for first in range(1, 1 + count) for second in range(first + 1, things)]
        self._parked_pairs = np.array(pairs, int).reshape(-1, 2)

    def find(self, state: State) -> None:
        """Find the collisions of a frame, and note crashes and impacts.

        Things are numbered: 0 is the car, then come the parked cars, then the walls.
        """
        scene, things = self._close_pairs(state)
        if not len(scene):
            return
        n, count = len(state.heading), 1 + state.parked.shape[1]
        centres, headings = np.empty((n, len(self._lengths), 2)), np.empty((n, len(self._lengths)))
        centres[:, 0], centres[:, 1:count], centres[:, count:] = state.position.T, state.parked, WALL_POSITIONS
        headings[:, 0], headings[:, 1:count], headings[:, count:] = state.heading, state.parked_heading, WALL_HEADINGS
        scenes = scene.repeat(2).reshape(-1, 2)
        heading = headings[scenes, things]
        polygons = corners(centres[scenes, things], heading, self._lengths[things], self._widths[things])
        by_ego = things[:, 0] == 0
        velocity = (state.speed * state.direction)[:, scene] * by_ego  # only the car moves by itself
        now, soon, push = separating_axis(polygons, velocity.T * self.dt)
        state.crashed[scene[now & by_ego]] = True

        if not soon.any():
            return
        scenes, things, push = scenes[soon], things[soon], push[soon]
        cars = things < count  # walls stay where they are
        by_car = cars[:, 1]
        push[by_car] /= 2
        impact = np.empty((len(push), 2, 2))
        impact[:, 0] = push
        np.negative(push, out=impact[:, 1])
        # Pairs stand in highway-env's order: where a car is pushed twice, the last push counts, as NumPy assigns.
        pushed = scenes[cars], things[cars]
        state.hit[pushed] = True
        state.impact[pushed] = impact[cars]
        state.disturbed[scenes[by_car, 0]] = True

    def _close_pairs(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return the pairs of things to be looked at closely, in highway-env's order: their scenes, and (n, 2) things.

        That is, in each scene the car with the parked ones, then with the walls, then the parked ones with theirs.
        """
        centres, count = state.position.T, 1 + state.parked.shape[1]
        travel = state.speed * self.dt
        found = []
        if count > 1:
            offset = state.parked - centres[:, None]
            scene, parked = np.nonzero(~out_of_reach(offset, CAR_DIAGONAL_M, CAR_DIAGONAL_M, travel[:, None]))
            found.append((scene, _with_car(1 + parked)))
        if self.walls:
            # The circles around the walls hold most of the lot: leave out first what cannot reach the line of a wall.
            reach, motion = extent(state.direction) + 1e-9, travel * state.direction
            left_below = reach - state.position - np.minimum(motion, 0)
            right_above = reach + state.position + np.maximum(motion, 0)
            outward = np.concatenate((left_below, right_above))[WALL_SIDES]
            scene, wall = np.nonzero(outward.T > WALL_DISTANCES)
            if len(scene):
                near = ~out_of_reach(
                    WALL_POSITIONS[wall] - centres[scene], CAR_DIAGONAL_M, WALL_DIAGONALS[wall], travel[scene]
                )
                if not near.all():
                    scene, wall = scene[near], wall[near]
            found.append((scene, _with_car(count + wall)))
        if state.disturbed.any():
            found.append(self._close_parked_pairs(state))
        if len(found) == 1:
            return found[0]
        if not found:
            return np.empty(0, int), np.empty((0, 2), int)
        return np.concatenate([scene for scene, _ in found]), np.concatenate([things for _, things in found])

    def _close_parked_pairs(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        rows = np.flatnonzero(state.disturbed)
        first, second = self._parked_pairs.T
        positions = np.concatenate([state.parked[rows], np.tile(WALL_POSITIONS, (len(rows), 1, 1))], axis=1)
        offset = positions[:, second - 1] - positions[:, first - 1]
        row, pair = np.nonzero(~out_of_reach(offset, CAR_DIAGONAL_M, self._diagonals[second], np.zeros(1)))
        return rows[row], self._parked_pairs[pair]


def extent(direction: np.ndarray) -> np.ndarray:
    """Return how far cars reach from their centres along x and y; direction and result have the shape (2, n)."""
    share = np.abs(direction)
    reach: np.ndarray = share * (CAR_LENGTH_M / 2)
    reach += share[::-1] * (CAR_WIDTH_M / 2)
    return reach


def _with_car(things: np.ndarray) -> np.ndarray:
    """Pair the car itself, thing 0, with others."""
    pairs = np.zeros((len(things), 2), np.int64)
    pairs[:, 1] = things
    return pairs

"""Who touches whom in a frame, in highway-env's order, and what follows from it.

In each scene highway-env looks at the car with the parked ones, then with the walls, then at the parked ones with each
other and with the walls. Where something is pushed twice in a frame, the last push counts.
"""

import numpy as np

from parking_exp.envs.geometry import (
    CAR_DIAGONAL_M,
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    WALL_DIAGONALS,
    WALL_HEADINGS,
    WALL_LENGTHS,
    WALL_POSITIONS,
    WALL_THICKNESS_M,
)
from parking_exp.envs.simulator.collisions import corners, out_of_reach, separating_axis
from parking_exp.envs.simulator.state import State

WALL_SIDES = np.array([1, 3, 0, 2])  # of the directions left, below, right, above
WALL_DISTANCES = np.linalg.norm(WALL_POSITIONS, axis=1) - WALL_THICKNESS_M / 2
WALL_CORNERS = corners(
    WALL_POSITIONS, np.stack([np.cos(WALL_HEADINGS), np.sin(WALL_HEADINGS)], axis=-1), WALL_LENGTHS, WALL_THICKNESS_M
)


class Contacts:
    """Finds the collisions of scenes. The things in a scene are numbered: the parked cars, then the walls.

    Args:
        dt: length of a frame [s].
        count: parked cars in each scene.
        walls: whether there are walls.
    """

    def __init__(self, dt: float, count: int, *, walls: bool) -> None:
        self.dt, self.count, self.walls = dt, count, walls
        things = count + len(WALL_LENGTHS) * walls
        pairs = [(first, second) for first in range(count) for second in range(first + 1, things)]
        self._pairs = np.array(pairs, int).reshape(-1, 2)
        self._diagonals = np.append(np.full(count, CAR_DIAGONAL_M), WALL_DIAGONALS)

    def find(self, state: State) -> None:
        """Find the collisions of a frame, and note crashes and impacts."""
        self._find_of_cars(state)
        # Parked cars stand apart until one of them is pushed.
        if state.disturbed.any():
            self._find_of_parked(state)

    def _find_of_cars(self, state: State) -> None:
        scene, thing = self._near_cars(state)
        if not len(scene):
            return
        polygons = np.empty((len(scene), 2, 4, 2))
        direction = state.direction.take(scene, axis=1)
        polygons[:, 0] = corners(state.position.take(scene, axis=1).T, direction.T, CAR_LENGTH_M, CAR_WIDTH_M)
        polygons[:, 1] = self._corners(state, scene, thing)
        now, soon, push = separating_axis(polygons, (state.speed[scene] * direction).T * self.dt)
        state.crashed[scene[now]] = True
        if soon.any():
            self._push(state, scene[soon], thing[soon], push[soon])

    def _push(self, state: State, scene: np.ndarray, thing: np.ndarray, push: np.ndarray) -> None:
        """Note that cars will be pushed out of things: the whole way out of a wall, half of it by a parked car."""
        if self.count:
            cars = thing < self.count
            push[cars] /= 2
            pushed = scene[cars], 1 + thing[cars]
            state.hit[pushed] = True
            state.impact[pushed] = -push[cars]
            state.disturbed[pushed[0]] = True
        state.hit[scene, 0] = True
        state.impact[scene, 0] = push

    def _find_of_parked(self, state: State) -> None:
        rows = np.flatnonzero(state.disturbed)
        positions = np.concatenate([state.parked[rows], np.tile(WALL_POSITIONS, (len(rows), 1, 1))], axis=1)
        first, second = self._pairs.T
        offset = positions[:, second] - positions[:, first]
        row, pair = np.nonzero(~out_of_reach(offset, CAR_DIAGONAL_M, self._diagonals[second], 0.0))
        if not len(row):
            return
        scenes, things = rows[row].repeat(2), self._pairs[pair]
        polygons = self._corners(state, scenes, things.ravel()).reshape(-1, 2, 4, 2)
        _, soon, push = separating_axis(polygons, np.zeros((len(row), 2)))
        things, push = things[soon], push[soon]
        cars = things < self.count
        push[cars[:, 1]] /= 2
        pushed = scenes.reshape(-1, 2)[soon][cars], 1 + things[cars]
        state.hit[pushed] = True
        state.impact[pushed] = np.stack([push, -push], axis=1)[cars]

    def _corners(self, state: State, scene: np.ndarray, thing: np.ndarray) -> np.ndarray:
        """Return the corners of things, shape (n, 4, 2)."""
        wall = thing - self.count
        found: np.ndarray = WALL_CORNERS.take(np.maximum(wall, 0), axis=0)
        if self.count:
            cars = wall < 0
            which = scene[cars], thing[cars]
            heading = state.parked_heading[which]
            direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            found[cars] = corners(state.parked[which], direction, CAR_LENGTH_M, CAR_WIDTH_M)
        return found

    def _near_cars(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return the things that the cars may touch, scene by scene, parked cars first: their scenes and numbers."""
        travel = state.speed * self.dt
        if not self.count:
            return self._near_walls(state, travel)
        offset = state.parked - state.position.T[:, None]
        scene, thing = np.nonzero(~out_of_reach(offset, CAR_DIAGONAL_M, CAR_DIAGONAL_M, travel[:, None]))
        at_wall, wall = self._near_walls(state, travel)
        return np.concatenate([scene, at_wall]), np.concatenate([thing, self.count + wall])

    def _near_walls(self, state: State, travel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not self.walls:
            return np.empty(0, int), np.empty(0, int)
        # The circles around the walls hold most of the lot: leave out first what cannot reach the line of a wall.
        reach, motion = extent(state.direction) + 1e-9, travel * state.direction
        left_below = reach - state.position - np.minimum(motion, 0)
        right_above = reach + state.position + np.maximum(motion, 0)
        outward = np.concatenate((left_below, right_above))[WALL_SIDES]
        scene, wall = np.nonzero(outward.T > WALL_DISTANCES)
        offset = WALL_POSITIONS.take(wall, axis=0) - state.position.take(scene, axis=1).T
        near = ~out_of_reach(offset, CAR_DIAGONAL_M, WALL_DIAGONALS[wall], travel[scene])
        return scene[near], wall[near]


def extent(direction: np.ndarray) -> np.ndarray:
    """Return how far cars reach from their centres along x and y; direction and result have the shape (2, n)."""
    share = np.abs(direction)
    reach: np.ndarray = share * (CAR_LENGTH_M / 2)
    reach += share[::-1] * (CAR_WIDTH_M / 2)
    return reach

"""Collision detection and response for one frame, in highway-env's order.

In each scene highway-env tests the car against the parked cars, the walls and the obstacles, then
the parked cars against each other, the walls and the obstacles. The last push of a frame counts. A
pair of rectangles is tested twice (`RoadObject._is_colliding`, `utils.are_polygons_intersecting`):
the circles around both, then the separating axis theorem, now and one frame ahead.

A car that was pushed out of another is exactly at contact in the next frame, where the last bit
decides. Therefore the arithmetic is highway-env's to the last bit: `vecdot` and `matmul` make the
same BLAS calls as its dot products.
"""

import numpy as np

from parking_exp.tasks.parking.geometry import (
    CAR_DIAGONAL_M,
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    OBSTACLE_DIAGONAL_M,
    OBSTACLE_M,
    WALL_DIAGONALS,
    WALL_HEADINGS,
    WALL_LENGTHS,
    WALL_POSITIONS,
    WALL_THICKNESS_M,
)
from parking_exp.tasks.parking.simulator.scene_state import SceneState

ALONG, ACROSS = np.array([-0.5, -0.5, 0.5, 0.5]), np.array([-0.5, 0.5, 0.5, -0.5])
NEXT_CORNER = np.array([1, 2, 3, 0])
WALL_SIDES = np.array([1, 3, 0, 2])  # of the directions left, below, right, above
WALL_DISTANCES = np.linalg.norm(WALL_POSITIONS, axis=1) - WALL_THICKNESS_M / 2

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
    corner_points: np.ndarray = np.add(rotated, position[..., None, :], order="C")
    return corner_points


def out_of_reach(
    offset: np.ndarray, diagonal: Lengths, other: Lengths, travel: Lengths
) -> np.ndarray:
    """Return where the circles around two rectangles are apart, which highway-env tests first.

    Args:
        offset: from the first centre to the second, shape (..., 2).
        diagonal, other: of the two rectangles, of a shape broadcastable to (...) [m].
        travel: signed speed times dt of the first, likewise; as in highway-env, the circles shrink
            in reverse.
    """
    apart: np.ndarray = np.sqrt(np.vecdot(offset, offset)) > (diagonal + other) / 2 + travel
    return apart


def separating_axis(polygons: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, ...]:
    """Test pairs of convex quadrilaterals, a and b, by the separating axis theorem.

    Args:
        polygons: corners of a and b, shape (n, 2, 4, 2).
        displacement: of a relative to b within the next frame, shape (n, 2).

    Returns:
        intersecting: whether they overlap now, shape (n,).
        will_intersect: whether they will overlap when displaced, shape (n,).
        translation: what would push a out of b then, shape (n, 2); meaningless where they will not
            overlap.
    """
    n = len(polygons)
    edges = polygons.take(NEXT_CORNER, axis=2) - polygons
    normals = np.empty((n, 8, 2))
    np.negative(edges[..., 1].reshape(n, 8), out=normals[..., 0])
    normals[..., 1] = edges[..., 0].reshape(n, 8)
    normals /= np.sqrt(np.vecdot(normals, normals))[..., None]
    shadows = np.vecdot(polygons.transpose(2, 1, 0, 3)[:, :, :, None], normals)  # (4, 2, n, 8)
    low_a, low_b = np.minimum.reduce(shadows)
    high_a, high_b = np.maximum.reduce(shadows)
    apart = (low_b > high_a) | (low_a > high_b)

    motion = np.vecdot(normals, np.ascontiguousarray(displacement)[:, None])
    low_a += np.minimum(motion, 0)
    high_a += np.maximum(motion, 0)
    # Signed distance of the shadows; where they overlap it is negative, and not always the whole
    # overlap.
    gap = np.where(low_a < low_b, low_b - high_a, low_a - high_b)
    will_be_apart = gap > 0

    overlap = np.abs(gap)
    axis = overlap.argmin(axis=1)
    pairs = np.arange(n)
    normal = normals[pairs, axis]
    centres = np.add.reduce(polygons, axis=2) / 4
    away = np.where(np.vecdot(centres[:, 0] - centres[:, 1], normal) > 0, 1.0, -1.0)
    translation = (overlap[pairs, axis] * away)[:, None] * normal
    return ~apart.any(axis=1), ~will_be_apart.any(axis=1), translation


def extent(direction: np.ndarray) -> np.ndarray:
    """Return how far cars reach from their centres along x and y; direction and result have the
    shape (2, n).
    """
    share = np.abs(direction)
    reach: np.ndarray = share * (CAR_LENGTH_M / 2)
    reach += share[::-1] * (CAR_WIDTH_M / 2)
    return reach


WALL_CORNERS = corners(
    WALL_POSITIONS,
    np.stack([np.cos(WALL_HEADINGS), np.sin(WALL_HEADINGS)], axis=-1),
    WALL_LENGTHS,
    WALL_THICKNESS_M,
)


class Collisions:
    """Collisions of all scenes in a frame of `dt` seconds.

    What can be hit is numbered: the `count` parked cars, then the walls, also where there are none,
    then the obstacles.
    """

    def __init__(self, dt: float, count: int, n_obstacles: int, *, walls: bool) -> None:
        self.dt, self.count, self.n_obstacles, self.walls = dt, count, n_obstacles, walls
        first_obstacle = count + len(WALL_LENGTHS)
        others = [
            *range(first_obstacle if walls else count),
            *range(first_obstacle, first_obstacle + n_obstacles),
        ]
        pairs = [(first, second) for first in range(count) for second in others if second > first]
        self._pairs = np.array(pairs, int).reshape(-1, 2)
        diagonals = (
            np.full(count, CAR_DIAGONAL_M),
            WALL_DIAGONALS,
            np.full(n_obstacles, OBSTACLE_DIAGONAL_M),
        )
        self._diagonals = np.concatenate(diagonals)

    def resolve(self, state: SceneState) -> None:
        """Detect the collisions of a frame; set crashes, and the impacts of the next frame, in the
        state.
        """
        self._resolve_cars(state)
        # Parked cars stand apart until one of them is pushed.
        if state.disturbed.any():
            self._resolve_vehicles(state)

    def _resolve_cars(self, state: SceneState) -> None:
        scene, target = self._near_cars(state)
        if not len(scene):
            return
        polygons = np.empty((len(scene), 2, 4, 2))
        direction = state.direction.take(scene, axis=1)
        polygons[:, 0] = corners(
            state.position.take(scene, axis=1).T, direction.T, CAR_LENGTH_M, CAR_WIDTH_M
        )
        polygons[:, 1] = self._corners(state, scene, target)
        now, soon, push = separating_axis(polygons, (state.speed[scene] * direction).T * self.dt)
        state.crashed[scene[now]] = True
        if soon.any():
            self._push(state, scene[soon], target[soon], push[soon])

    def _push(
        self, state: SceneState, scene: np.ndarray, target: np.ndarray, push: np.ndarray
    ) -> None:
        """Set impacts: walls and obstacles push all the way out, parked cars half, and are pushed
        as far themselves.
        """
        if self.count:
            cars = target < self.count
            push[cars] /= 2
            pushed = scene[cars], 1 + target[cars]
            state.hit[pushed] = True
            state.impact[pushed] = -push[cars]
            state.disturbed[pushed[0]] = True
        state.hit[scene, 0] = True
        state.impact[scene, 0] = push

    def _resolve_vehicles(self, state: SceneState) -> None:
        rows = np.flatnonzero(state.disturbed)
        walls = np.tile(WALL_POSITIONS, (len(rows), 1, 1))
        positions = np.concatenate([state.vehicles[rows], walls, state.obstacles[rows]], axis=1)
        first, second = self._pairs.T
        offset = positions[:, second] - positions[:, first]
        row, pair = np.nonzero(~out_of_reach(offset, CAR_DIAGONAL_M, self._diagonals[second], 0.0))
        if not len(row):
            return
        scenes, targets = rows[row].repeat(2), self._pairs[pair]
        polygons = self._corners(state, scenes, targets.ravel()).reshape(-1, 2, 4, 2)
        _, soon, push = separating_axis(polygons, np.zeros((len(row), 2)))
        targets, push = targets[soon], push[soon]
        cars = targets < self.count
        push[cars[:, 1]] /= 2
        pushed = scenes.reshape(-1, 2)[soon][cars], 1 + targets[cars]
        state.hit[pushed] = True
        state.impact[pushed] = np.stack([push, -push], axis=1)[cars]

    def _corners(self, state: SceneState, scene: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the corners of what can be hit, shape (n, 4, 2)."""
        wall = target - self.count
        target_corners: np.ndarray = WALL_CORNERS.take(
            np.clip(wall, 0, len(WALL_LENGTHS) - 1), axis=0
        )
        if self.n_obstacles:
            placed = wall >= len(WALL_LENGTHS)
            places = state.obstacles[scene[placed], wall[placed] - len(WALL_LENGTHS)]
            target_corners[placed] = corners(
                places, np.tile([1.0, 0.0], (len(places), 1)), OBSTACLE_M, OBSTACLE_M
            )
        if self.count:
            cars = wall < 0
            which = scene[cars], target[cars]
            heading = state.vehicle_heading[which]
            direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            target_corners[cars] = corners(
                state.vehicles[which], direction, CAR_LENGTH_M, CAR_WIDTH_M
            )
        return target_corners

    def _near_cars(self, state: SceneState) -> tuple[np.ndarray, np.ndarray]:
        """Return scenes and numbers of what the cars may touch, in highway-env's order."""
        travel = state.speed * self.dt
        at_wall, wall = self._near_walls(state, travel)
        scenes, numbers = [at_wall], [self.count + wall]
        if self.count:
            offset = state.vehicles - state.position.T[:, None]
            scene, car = np.nonzero(
                ~out_of_reach(offset, CAR_DIAGONAL_M, CAR_DIAGONAL_M, travel[:, None])
            )
            scenes, numbers = [scene, *scenes], [car, *numbers]
        if self.n_obstacles:
            offset = state.obstacles - state.position.T[:, None]
            scene, number = np.nonzero(
                ~out_of_reach(offset, CAR_DIAGONAL_M, OBSTACLE_DIAGONAL_M, travel[:, None])
            )
            scenes, numbers = [*scenes, scene], [*numbers, self.count + len(WALL_LENGTHS) + number]
        return np.concatenate(scenes), np.concatenate(numbers)

    def _near_walls(self, state: SceneState, travel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not self.walls:
            return np.empty(0, int), np.empty(0, int)
        # The circles around the walls cover most of the lot: first drop cars that cannot reach the
        # line of a wall.
        reach, motion = extent(state.direction) + 1e-9, travel * state.direction
        left_below = reach - state.position - np.minimum(motion, 0)
        right_above = reach + state.position + np.maximum(motion, 0)
        outward = np.concatenate((left_below, right_above))[WALL_SIDES]
        scene, wall = np.nonzero(outward.T > WALL_DISTANCES)
        offset = WALL_POSITIONS.take(wall, axis=0) - state.position.take(scene, axis=1).T
        near = ~out_of_reach(offset, CAR_DIAGONAL_M, WALL_DIAGONALS[wall], travel[scene])
        return scene[near], wall[near]

"""Collision detection and response for one frame, in highway-env's order.

In each scene highway-env tests the car against the parked cars, the walls and the obstacles, then
the parked cars against each other, the walls and the obstacles. The last push of a frame counts.

A pair of rectangles is tested twice. `RoadObject._is_colliding` tests the circles around both,
which are smaller in reverse. Then `utils.are_polygons_intersecting` applies the separating axis
theorem, now and one frame ahead.

A car that was pushed out of another is exactly at contact in the next frame, where the last bit
decides. Therefore the arithmetic is highway-env's to the last bit: `vecdot` and `matmul` make the
same BLAS calls as its dot products.
"""

from dataclasses import dataclass

import numpy as np

from parking_exp.tasks.parking.geometry import (
    CAR_DIAGONAL_M,
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    N_WALLS,
    TINY_M,
    WALL_ALONG,
    WALL_SIDES,
    corners,
    extent,
    join_rectangles,
    obstacles_at,
    walls_around,
)
from parking_exp.tasks.parking.simulator.scene_state import SceneState

NEXT_CORNER = np.array([1, 2, 3, 0])
WALL_ACROSS = 1 - WALL_ALONG


def length_of(vector: np.ndarray) -> np.ndarray:
    """Return the lengths of vectors of shape (..., 2), as highway-env computes them."""
    length: np.ndarray = np.sqrt(np.vecdot(vector, vector))
    return length


def separating_axis(polygons: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, ...]:
    """Test pairs of convex quadrilaterals, a and b, by the separating axis theorem.

    Args:
        polygons: corners of a and b, shape (n, 2, 4, 2).
        displacement: the motion of a relative to b within the next frame, shape (n, 2).

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
    normals /= length_of(normals)[..., None]
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


@dataclass(frozen=True)
class Fixtures:
    """What never moves in n scenes: the walls, if there are any, then the obstacles."""

    centres: np.ndarray  # shape (n, fixtures, 2) [m]
    # The distance from a car's centre at which the circles around both touch, shape (n, fixtures)
    # [m].
    reach: np.ndarray
    corners: np.ndarray  # shape (n, fixtures, 4, 2) [m]

    def repeated(self, n: int) -> "Fixtures":
        """Return the fixtures of one scene for n scenes, as views, which take no memory."""
        shapes = [np.broadcast_to(array[0], (n, *array.shape[1:])) for array in vars(self).values()]
        return Fixtures(*shapes)


class Collisions:
    """Collisions of all scenes in a frame of `dt` seconds.

    What can be hit is numbered: the `n_parked` parked cars, then the fixtures.

    Args:
        dt: the length of a frame [s].
        n_parked: the number of parked cars of a scene, absent ones included.
        n_obstacles: the number of obstacles of a scene.
        walls: whether there are walls around the lot.
    """

    def __init__(self, dt: float, n_parked: int, n_obstacles: int, *, walls: bool) -> None:
        self.dt = dt
        self.n_parked = n_parked
        self.n_walls = N_WALLS if walls else 0
        self.n_fixtures = self.n_walls + n_obstacles
        # All pairs of a parked car and what it can hit, as two arrays of numbers, in highway-env's
        # order.
        self._first, self._second = np.triu_indices(n_parked, k=1, m=n_parked + self.n_fixtures)

    def fixtures(self, state: SceneState) -> Fixtures:
        """Return what `resolve` needs in all frames of the same scenes."""
        parts = [obstacles_at(state.obstacles)]
        if self.n_walls:
            parts.insert(0, walls_around(state.free))
        rectangles = join_rectangles(parts)
        heading = rectangles.heading
        direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        length, width = np.moveaxis(rectangles.size, -1, 0)
        shapes = corners(rectangles.centre, direction, length, width)
        reach = (CAR_DIAGONAL_M + rectangles.diagonal) / 2
        return Fixtures(rectangles.centre, reach, shapes)

    def resolve(self, state: SceneState, fixtures: Fixtures) -> None:
        """Detect a frame's collisions; set crashes, and impacts of the next frame, in the state."""
        self._resolve_cars(state, fixtures)
        # Parked cars stand apart until one of them has been pushed.
        if self.n_parked and state.pushed.any():
            self._resolve_parked_cars(state, fixtures)

    def _resolve_cars(self, state: SceneState, fixtures: Fixtures) -> None:
        """Detect what the cars touch, and what they will touch in the next frame."""
        scene, target, shapes = self._near_cars(state, fixtures)
        if not len(scene):
            return

        polygons = np.empty((len(scene), 2, 4, 2))
        position = state.position.take(scene, axis=1)
        direction = state.direction.take(scene, axis=1)
        polygons[:, 0] = corners(position.T, direction.T, CAR_LENGTH_M, CAR_WIDTH_M)
        polygons[:, 1] = shapes
        displacement = (state.speed[scene] * direction).T * self.dt
        now, soon, push = separating_axis(polygons, displacement)
        state.crashed[scene[now]] = True
        if soon.any():
            self._push(state, scene[soon], 0, target[soon], push[soon])

    def _push(
        self,
        state: SceneState,
        scene: np.ndarray,
        vehicle: np.ndarray | int,
        target: np.ndarray,
        push: np.ndarray,
    ) -> None:
        """Set the displacements of vehicles and their targets in the next frame.

        Walls and obstacles push a vehicle all the way out. A parked car pushes it half of the way,
        and is pushed the other half itself. Vehicle number 0 is the car.
        """
        # The last push of a frame counts. In highway-env's order, a parked car is the target in all
        # pairs before the first one that it begins, so targets are set first.
        if self.n_parked:
            is_parked = target < self.n_parked
            push[is_parked] /= 2
            pushed = (scene[is_parked], 1 + target[is_parked])
            state.hit[pushed] = True
            state.impact[pushed] = -push[is_parked]
        state.hit[scene, vehicle] = True
        state.impact[scene, vehicle] = push

    def _near_cars(
        self, state: SceneState, fixtures: Fixtures
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return scenes, numbers and corners of what the cars may touch, in highway-env's order."""
        travel = state.speed * self.dt
        scene, fixture = self._near_fixtures(state, fixtures, travel)
        target = self.n_parked + fixture
        shapes = fixtures.corners[scene, fixture]
        if not self.n_parked:
            return scene, target, shapes
        offset = state.vehicles - state.position.T[:, None]
        near = np.nonzero(length_of(offset) <= CAR_DIAGONAL_M + travel[:, None])
        cars = _parked_cars(state.vehicles[near], state.vehicle_heading[near])
        vehicle_scene, vehicle = near
        return (
            np.concatenate([vehicle_scene, scene]),
            np.concatenate([vehicle, target]),
            np.concatenate([cars, shapes]),
        )

    def _near_fixtures(
        self, state: SceneState, fixtures: Fixtures, travel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return scenes, and numbers of the fixtures in them that the cars may touch."""
        maybe = np.ones((len(travel), self.n_fixtures), bool)
        if self.n_walls:
            # The circles around the walls cover most of the lot: first drop cars that cannot reach
            # the line of a wall.
            ahead = np.maximum(WALL_SIDES @ (travel * state.direction), 0)
            ahead += WALL_SIDES @ state.position
            free = state.free - extent(state.direction) - TINY_M
            maybe[:, : self.n_walls] = (ahead > free[WALL_ACROSS]).T
        scene, fixture = np.nonzero(maybe)
        if not len(scene):
            return scene, fixture
        offset = fixtures.centres[scene, fixture] - state.position.take(scene, axis=1).T
        reach = fixtures.reach[scene, fixture] + travel[scene]
        near = length_of(offset) <= reach
        return scene[near], fixture[near]

    def _resolve_parked_cars(self, state: SceneState, fixtures: Fixtures) -> None:
        """Detect what parked cars will touch in the next frame, in scenes where one was pushed."""
        scenes = np.flatnonzero(state.pushed.any(axis=1))
        vehicles = state.vehicles[scenes]
        cars = _parked_cars(vehicles, state.vehicle_heading[scenes])
        centres = np.concatenate([vehicles, fixtures.centres[scenes]], axis=1)
        shapes = np.concatenate([cars, fixtures.corners[scenes]], axis=1)
        reach = np.full(centres.shape[:2], CAR_DIAGONAL_M)
        reach[:, self.n_parked :] = fixtures.reach[scenes]
        pushed = np.zeros(centres.shape[:2], bool)
        pushed[:, : self.n_parked] = state.pushed[scenes]

        row, pair = np.nonzero(pushed[:, self._first] | pushed[:, self._second])
        first = self._first[pair]
        second = self._second[pair]
        offset = centres[row, second] - centres[row, first]
        near = length_of(offset) <= reach[row, second]
        row = row[near]
        first = first[near]
        second = second[near]

        polygons = shapes[row[:, None], np.stack([first, second], axis=1)]
        _, soon, push = separating_axis(polygons, np.zeros((len(row), 2)))
        self._push(state, scenes[row[soon]], 1 + first[soon], second[soon], push[soon])


def _parked_cars(position: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Return the corners of parked cars, shape (..., 4, 2); positions have the shape (..., 2)."""
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return corners(position, direction, CAR_LENGTH_M, CAR_WIDTH_M)

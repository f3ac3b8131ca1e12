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
    N_WALLS,
    OBSTACLE_DIAGONAL_M,
    OBSTACLE_M,
    WALL_ALONG,
    WALL_HEADINGS,
    WALL_SIDES,
    WALL_THICKNESS_M,
    Lengths,
    corners,
)
from parking_exp.tasks.parking.simulator.scene_state import SceneState

NEXT_CORNER = np.array([1, 2, 3, 0])
WALL_DIRECTIONS = np.stack([np.cos(WALL_HEADINGS), np.sin(WALL_HEADINGS)], axis=-1)
OUTWARD = np.array([1, 3, 0, 2])  # of the directions left, below, right, above, those of walls
WALL_ACROSS = 1 - WALL_ALONG


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
    return np.sqrt(np.vecdot(offset, offset)) > (diagonal + other) / 2 + travel


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


def walls_of(free: np.ndarray, wall: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and lengths of walls [m].

    Args:
        free: half the space between their inner faces, shape (2, n) [m].
        wall: the number of one wall for each scene, shape (n,); None for all four.

    Returns:
        Centres of shape (n, 2) and lengths of shape (n,), or (n, 4, 2) and (n, 4) for all walls.
    """
    half = (free + WALL_THICKNESS_M / 2).T
    if wall is None:
        half = half[:, None]
        wall = np.arange(N_WALLS)
    lengths = 2 * np.where(WALL_ALONG[wall] == 0, half[..., 0], half[..., 1])
    return half * WALL_SIDES[wall], lengths


def diagonals(length: np.ndarray) -> np.ndarray:
    """Return the diagonals of walls, of the shape of their lengths [m]."""
    return np.sqrt(length**2 + WALL_THICKNESS_M**2)


class Collisions:
    """Collisions of all scenes in a frame of `dt` seconds.

    What can be hit is numbered: the `count` parked cars, then the walls, also where there are none,
    then the obstacles.
    """

    def __init__(self, dt: float, count: int, n_obstacles: int, *, walls: bool) -> None:
        self.dt = dt
        self.count = count
        self.n_obstacles = n_obstacles
        self.walls = walls
        self._first_obstacle = count + N_WALLS
        n_targets = self._first_obstacle + n_obstacles
        first, second = np.triu_indices(count, k=1, m=n_targets)
        if not walls:
            is_wall = (second >= count) & (second < self._first_obstacle)
            first = first[~is_wall]
            second = second[~is_wall]
        # Of what parked cars can hit, shape (pairs, 2).
        self._pairs = np.stack([first, second], axis=1)

    def resolve(self, state: SceneState) -> None:
        """Detect the collisions of a frame; set crashes, and the impacts of the next frame, in the
        state.
        """
        self._resolve_cars(state)
        # Parked cars stand apart until one of them is pushed.
        if state.disturbed.any():
            self._resolve_parked_cars(state)

    def _resolve_cars(self, state: SceneState) -> None:
        scene, target = self._near_cars(state)
        if not len(scene):
            return
        polygons = np.empty((len(scene), 2, 4, 2))
        position = state.position.take(scene, axis=1)
        direction = state.direction.take(scene, axis=1)
        polygons[:, 0] = corners(position.T, direction.T, CAR_LENGTH_M, CAR_WIDTH_M)
        polygons[:, 1] = self._corners(state, scene, target)
        displacement = (state.speed[scene] * direction).T * self.dt
        now, soon, push = separating_axis(polygons, displacement)
        state.crashed[scene[now]] = True
        if soon.any():
            self._push_cars(state, scene[soon], target[soon], push[soon])

    def _push_cars(
        self, state: SceneState, scene: np.ndarray, target: np.ndarray, push: np.ndarray
    ) -> None:
        """Set impacts: walls and obstacles push all the way out, parked cars half, and are pushed
        as far themselves.
        """
        if self.count:
            is_vehicle = target < self.count
            push[is_vehicle] /= 2
            state.disturbed[scene[is_vehicle]] = True
            _set_impacts(state, scene[is_vehicle], 1 + target[is_vehicle], -push[is_vehicle])
        _set_impacts(state, scene, 0, push)

    def _resolve_parked_cars(self, state: SceneState) -> None:
        scene, pair = self._near_pairs(state)
        if not len(scene):
            return
        scenes = np.stack([scene, scene], axis=1)
        targets = self._pairs[pair]
        polygons = self._corners(state, scenes.ravel(), targets.ravel()).reshape(-1, 2, 4, 2)
        _, soon, push = separating_axis(polygons, np.zeros((len(pair), 2)))

        scenes = scenes[soon]
        targets = targets[soon]
        push = push[soon]
        is_vehicle = targets < self.count
        push[is_vehicle[:, 1]] /= 2
        # Pair by pair, since the last push of a frame counts.
        pushes = np.stack([push, -push], axis=1)
        _set_impacts(state, scenes[is_vehicle], 1 + targets[is_vehicle], pushes[is_vehicle])

    def _near_pairs(self, state: SceneState) -> tuple[np.ndarray, np.ndarray]:
        """Return scenes, and numbers of the pairs in them of which a parked car may touch the
        other.
        """
        disturbed = np.flatnonzero(state.disturbed)
        n = len(disturbed)
        walls, lengths = walls_of(state.free[:, disturbed])
        parts = [state.vehicles[disturbed], walls, state.obstacles[disturbed]]
        positions = np.concatenate(parts, axis=1)
        cars = np.full((n, self.count), CAR_DIAGONAL_M)
        obstacles = np.full((n, self.n_obstacles), OBSTACLE_DIAGONAL_M)
        diagonal = np.concatenate([cars, diagonals(lengths), obstacles], axis=1)
        first, second = self._pairs.T
        offset = positions[:, second] - positions[:, first]
        apart = out_of_reach(offset, CAR_DIAGONAL_M, diagonal[:, second], 0.0)
        row, pair = np.nonzero(~apart)
        return disturbed[row], pair

    def _corners(self, state: SceneState, scene: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the corners of what can be hit, shape (n, 4, 2)."""
        is_vehicle = target < self.count
        is_obstacle = target >= self._first_obstacle
        is_wall = ~(is_vehicle | is_obstacle)
        target_corners = np.empty((len(scene), 4, 2))
        wall = target[is_wall] - self.count
        if len(wall):
            centres, lengths = walls_of(state.free[:, scene[is_wall]], wall)
            target_corners[is_wall] = corners(
                centres, WALL_DIRECTIONS[wall], lengths, WALL_THICKNESS_M
            )
        if self.n_obstacles:
            number = target[is_obstacle] - self._first_obstacle
            places = state.obstacles[scene[is_obstacle], number]
            direction = np.tile([1.0, 0.0], (len(places), 1))
            target_corners[is_obstacle] = corners(places, direction, OBSTACLE_M, OBSTACLE_M)
        if self.count:
            index = scene[is_vehicle], target[is_vehicle]
            heading = state.vehicle_heading[index]
            direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            target_corners[is_vehicle] = corners(
                state.vehicles[index], direction, CAR_LENGTH_M, CAR_WIDTH_M
            )
        return target_corners

    def _near_cars(self, state: SceneState) -> tuple[np.ndarray, np.ndarray]:
        """Return scenes and numbers of what the cars may touch, in highway-env's order."""
        travel = state.speed * self.dt
        scenes = []
        targets = []
        if self.count:
            scene, vehicle = _within_reach(state, state.vehicles, CAR_DIAGONAL_M, travel)
            scenes.append(scene)
            targets.append(vehicle)
        scene, wall = self._near_walls(state, travel)
        scenes.append(scene)
        targets.append(self.count + wall)
        if self.n_obstacles:
            scene, obstacle = _within_reach(state, state.obstacles, OBSTACLE_DIAGONAL_M, travel)
            scenes.append(scene)
            targets.append(self._first_obstacle + obstacle)
        return np.concatenate(scenes), np.concatenate(targets)

    def _near_walls(self, state: SceneState, travel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if not self.walls:
            return np.empty(0, int), np.empty(0, int)
        # The circles around the walls cover most of the lot: first drop cars that cannot reach the
        # line of a wall.
        reach = extent(state.direction) + 1e-9
        motion = travel * state.direction
        left_below = reach - state.position - np.minimum(motion, 0)
        right_above = reach + state.position + np.maximum(motion, 0)
        outward = np.concatenate((left_below, right_above))[OUTWARD]
        scene, wall = np.nonzero((outward > state.free[WALL_ACROSS]).T)
        if not len(scene):
            return scene, wall
        centres, lengths = walls_of(state.free[:, scene], wall)
        offset = centres - state.position.take(scene, axis=1).T
        near = ~out_of_reach(offset, CAR_DIAGONAL_M, diagonals(lengths), travel[scene])
        return scene[near], wall[near]


def _within_reach(
    state: SceneState, places: np.ndarray, diagonal: float, travel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return scenes, and numbers of the places in them, shape (n, places, 2), that the cars may
    touch.
    """
    offset = places - state.position.T[:, None]
    apart = out_of_reach(offset, CAR_DIAGONAL_M, diagonal, travel[:, None])
    scene, number = np.nonzero(~apart)
    return scene, number


def _set_impacts(
    state: SceneState, scene: np.ndarray, vehicle: np.ndarray | int, impact: np.ndarray
) -> None:
    """Set by how much vehicles are displaced in the next frame; number 0 is the car itself."""
    state.hit[scene, vehicle] = True
    state.impact[scene, vehicle] = impact

"""Vectorized simulator of parking: many scenes at once, exactly as highway-env, in NumPy alone.

A policy step is a few simulation frames of constant action. Nearly all scenes have no possible
contact in a step. They are integrated without collisions. The others are integrated frame by frame,
in highway-env's order: limit the action, move, apply the impact of the previous frame, detect
collisions.
"""

from copy import copy
from typing import Any

import numpy as np

from parking_exp.tasks.parking.geometry import (
    CAR_DIAGONAL_M,
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    cars_at,
    direction_of,
    extent,
    join_rectangles,
    may_overlap,
    obstacles_at,
    walls_around,
)
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.nearby_vehicles import nearest_vehicles
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.pose import PoseInSlot, pose_in_slot
from parking_exp.tasks.parking.rays import ray_distances
from parking_exp.tasks.parking.reward import reward_of
from parking_exp.tasks.parking.scenes import MOST_SCENES, Scenes
from parking_exp.tasks.parking.simulator.collisions import Collisions, Fixtures
from parking_exp.tasks.parking.simulator.dynamics import (
    Limits,
    advance,
    limited_acceleration,
    slip_angle,
)
from parking_exp.tasks.parking.simulator.scene_state import MOVING, SceneState, scaled_features
from parking_exp.tasks.task import Step, TrainingBatch

HALF_CAR_M = np.array([[CAR_LENGTH_M / 2], [CAR_WIDTH_M / 2]])


class Simulator(TrainingBatch):
    """Scenes of one env config that are simulated together, without autoreset.

    Args:
        config: the config of the env.
        scenes: n scenes, with room for the most parked cars of the config.

    Attributes:
        state: the state of the scenes now.
        reward: the reward of goals, without the penalty for a crash.
    """

    state: SceneState

    def __init__(self, config: ParkingConfig, scenes: Scenes) -> None:
        action = config.action
        self._low = np.array([[low] for low, _ in action.ranges])
        self._span = np.array([[high - low] for low, high in action.ranges])
        low, high = action.range_of("speed_range")
        self.speed_range: Limits = (low, high)
        self.clip = action.clip
        self.frames_per_step = config.frames_per_step
        self.dt = 1 / config.simulation_frequency
        self.episode_steps = config.episode_steps
        self.walls = config.add_walls
        self.reward = reward_of(config)
        self.n_seen = config.observation.vehicles_count
        self.rays = config.observation.rays
        self.rays_range_m = config.observation.rays_range_m
        lot = lot_of(config)
        self._nearest_row_m = lot.nearest_row_m
        self._collisions = Collisions(
            self.dt, config.vehicles_range[1], config.obstacles, walls=config.add_walls
        )
        sizes = scenes.vehicles.shape[1], scenes.obstacles.shape[1]
        assert sizes == (config.vehicles_range[1], config.obstacles), (
            f"scenes have {sizes} vehicles and obstacles"
        )
        self.start(scenes)
        self._fixtures: Fixtures | None = None  # None: made anew in each step
        if lot.same_walls and not config.obstacles:
            single_scene_fixtures = self._collisions.fixtures(self.state.take(np.array([0])))
            self._fixtures = single_scene_fixtures.repeated(MOST_SCENES)

    def __len__(self) -> int:
        return len(self.state.heading)

    def start(self, episodes: Scenes, rows: np.ndarray | None = None) -> None:
        """Start other scenes, in all rows or in some."""
        if rows is None:
            self.state = SceneState.at_start(episodes)
        else:
            self.state.put(rows, SceneState.at_start(episodes))

    def keep(self, rows: np.ndarray) -> None:
        """Keep only some of the scenes, by index or mask."""
        self.state = self.state.take(np.arange(len(self))[rows])

    def observe(self, rows: np.ndarray | slice = slice(None)) -> dict[str, np.ndarray]:
        """Return the observation of all scenes, or of some."""
        state = self.state
        car = scaled_features(state.position[:, rows], state.direction[:, rows], state.speed[rows])
        seen = [car]
        if self.n_seen:
            seen.append(self._observe_vehicles(rows))
        if self.rays:
            seen.append(self._observe_rays(rows))
        return {
            "observation": np.concatenate(seen, axis=1),
            "achieved_goal": car,
            "desired_goal": state.goal_features[rows].copy(),
        }

    def _observe_vehicles(self, rows: np.ndarray | slice) -> np.ndarray:
        """Return what the cars see of parked cars and obstacles."""
        state = self.state
        obstacles = state.obstacles[rows]
        others = np.concatenate([state.vehicles[rows], obstacles], axis=1)
        headings = [state.vehicle_heading[rows], np.zeros(obstacles.shape[:2])]
        heading = np.concatenate(headings, axis=1)
        return nearest_vehicles(state.position[:, rows].T, others, heading, self.n_seen)

    def _observe_rays(self, rows: np.ndarray | slice) -> np.ndarray:
        """Return the distances that the cars see along rays, as fractions of the range."""
        state = self.state
        parts = [
            cars_at(state.vehicles[rows], state.vehicle_heading[rows]),
            obstacles_at(state.obstacles[rows]),
        ]
        if self.walls:
            parts.append(walls_around(state.free[:, rows]))
        position = state.position[:, rows]
        direction = state.direction[:, rows]
        distances = ray_distances(
            position, direction, join_rectangles(parts), self.rays, self.rays_range_m
        )
        return distances / self.rays_range_m

    def step(self, actions: np.ndarray) -> Step:
        """Drive all scenes for one policy step; actions (n, 2) are acceleration, then steering."""
        state = self.state
        actions = np.asarray(actions)
        if actions.dtype.kind != "f":
            actions = actions.astype(np.float64)
        assert actions.shape == (len(self), 2), f"actions have the shape {actions.shape}"
        acceleration, steering = self.controls(actions)
        before = copy(state)
        rows = self._drive(acceleration, steering)
        if len(rows):
            part = before.take(rows)
            self._drive_by_frames(part, acceleration[rows], steering[rows])
            state.put(rows, part, MOVING)
        state.steps += 1
        return self._make_step()

    def ending(self, row: int) -> PoseInSlot:
        """Return the pose of a car relative to its goal."""
        state = self.state
        return pose_in_slot(
            state.position[:, row],
            state.heading[row],
            state.speed[row],
            state.goal[row, :2],
            state.goal[row, 2],
            state.slot_size[row],
        )

    def info(self, row: int) -> dict[str, Any]:
        """Return entries of highway-env's `info`."""
        state = self.state
        return {"speed": float(state.speed[row]), "crashed": bool(state.crashed[row])}

    def get_state(self) -> dict[str, np.ndarray]:
        """Return a copy of the state as plain arrays, to be saved and given to `set_state`."""
        return {name: array.copy() for name, array in vars(self.state).items()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state; what follows is identical."""
        self.state = SceneState(**{name: np.array(array) for name, array in state.items()})

    def controls(self, actions: np.ndarray) -> np.ndarray:
        """Return the accelerations and steering angles that actions ask for, shape (2, n) [m/s2,
        rad]; actions have the shape (n, 2).
        """
        scaled = np.ascontiguousarray(actions.T)
        if self.clip:
            scaled = np.minimum(np.maximum(scaled, -1), 1)
        # From [-1, 1] to the ranges, in the precision of the actions, as highway-env does.
        scaled = scaled - -1
        scaled *= self._span.astype(actions.dtype)
        scaled /= 2
        scaled += self._low.astype(actions.dtype)
        return scaled.astype(np.float64)

    def _drive(self, acceleration: np.ndarray, steering: np.ndarray) -> np.ndarray:
        """Integrate all frames as if without obstacles; return the rows where that may be wrong."""
        state = self.state
        position = state.position
        heading = state.heading
        speed = state.speed
        slip = slip_angle(steering)
        sin_slip = np.sin(slip)
        gain = acceleration * self.dt
        farthest = np.abs(position)
        for _ in range(self.frames_per_step):
            position, heading, speed = advance(
                position, heading, speed, gain, slip, sin_slip, self.dt
            )
            if self.walls:
                np.maximum(farthest, np.abs(position), out=farthest)

        slowest = np.minimum(state.speed, speed)
        fastest = np.maximum(state.speed, speed)
        state.position = position
        state.heading = heading
        state.speed = speed
        state.direction = direction_of(heading)
        return np.flatnonzero(self._find_uncertain(slowest, fastest, farthest, sin_slip))

    def _find_uncertain(
        self, slowest: np.ndarray, fastest: np.ndarray, farthest: np.ndarray, sin_slip: np.ndarray
    ) -> np.ndarray:
        """Return a mask of the scenes in which a car may have been too fast or touched something.

        Args:
            slowest, fastest: the lowest and the highest speed of each car in the step, shape (n,).
            farthest: its largest distances from the middle of the lot, shape (2, n).
            sin_slip: sine of the `slip_angle`, shape (n,).
        """
        state = self.state
        low, high = self.speed_range
        uncertain = state.crashed | state.hit[:, 0]
        uncertain |= slowest < low
        uncertain |= fastest > high
        frame_travel = np.maximum(fastest, -slowest) * self.dt
        # During the step, the car's heading differs from its last one by at most `turn` [rad]. That
        # displaces its corners by at most `swing` [m].
        turn = np.abs(sin_slip) * frame_travel * (self.frames_per_step / (CAR_LENGTH_M / 2))
        swing = turn * (CAR_DIAGONAL_M / 2)
        if self.walls:
            near = farthest + extent(state.direction) + (frame_travel + swing) > state.free
            uncertain |= near[0]
            uncertain |= near[1]
        # The car goes at most this far from the end of the first frame to one frame after the last.
        # Its course differs from its last heading by at most the turn and the slip.
        motion = frame_travel * self.frames_per_step
        if state.vehicles.shape[1]:
            swept = np.array([motion, motion * (turn + np.abs(sin_slip))])
            swept += swing + HALF_CAR_M
            uncertain[self._near_vehicles(motion + CAR_DIAGONAL_M, swept)] = True
        if state.obstacles.shape[1]:
            within = _within(motion + CAR_DIAGONAL_M, state.position, state.obstacles)
            uncertain |= within.any(axis=1)
        return uncertain

    def _near_vehicles(self, reach: np.ndarray, swept: np.ndarray) -> np.ndarray:
        """Return the scenes where a car may touch a parked one in its place.

        Args:
            reach: the distances between centres within which cars may touch parked ones, shape
                (n,) [m].
            swept: half length and half width of a rectangle around each car that it doesn't leave
                in the step, shape (2, n) [m].
        """
        state = self.state
        close = np.flatnonzero(np.abs(state.position[1]) + reach > self._nearest_row_m)
        within = _within(reach[close], state.position[:, close], state.vehicles[close])
        row, vehicle = np.nonzero(within)
        scene = close[row]
        heading = state.vehicle_heading[scene, vehicle]
        touching = may_overlap(
            state.vehicles[scene, vehicle].T - state.position[:, scene],
            state.direction[:, scene],
            swept[:, scene],
            direction_of(heading),
            HALF_CAR_M,
        )
        return scene[touching]

    def _drive_by_frames(
        self, state: SceneState, acceleration: np.ndarray, steering: np.ndarray
    ) -> None:
        """Integrate a step frame by frame, in place, with speed limits, collisions and effects."""
        low, high = self.speed_range
        fastest = np.abs(state.speed) + np.abs(acceleration) * (self.frames_per_step * self.dt)
        may_exceed_limits = fastest.max() > min(-low, high)
        slip = slip_angle(steering)
        sin_slip = np.sin(slip)
        fixtures = self._fixtures or self._collisions.fixtures(state)
        for _ in range(self.frames_per_step):
            if state.crashed.any():
                # No steering, and full brakes.
                slip[state.crashed] = 0.0
                sin_slip[state.crashed] = 0.0
                acceleration = np.where(state.crashed, -state.speed, acceleration)
            if may_exceed_limits:
                acceleration = limited_acceleration(acceleration, state.speed, self.speed_range)
            state.position, state.heading, state.speed = advance(
                state.position,
                state.heading,
                state.speed,
                acceleration * self.dt,
                slip,
                sin_slip,
                self.dt,
            )
            if state.hit.any():
                state.position += state.impact[:, 0].T
                state.vehicles += state.impact[:, 1:]
                state.crashed |= state.hit[:, 0]
                state.pushed |= state.hit[:, 1:]
                state.hit[:] = False
                state.impact[:] = 0.0
            state.direction = direction_of(state.heading)
            self._collisions.resolve(state, fixtures)

    def _make_step(self) -> Step:
        state = self.state
        observation = self.observe()
        reward, success = self.reward(
            observation["achieved_goal"], observation["desired_goal"], state.slot_size
        )
        crashed = state.crashed.copy()
        return Step(
            observation=observation,
            reward=reward + self.reward.failure_penalty * crashed,
            terminated=crashed | success,
            truncated=state.steps >= self.episode_steps,
            failed=crashed,
            is_success=success,
        )


def _within(reach: np.ndarray, position: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return which of the places, shape (n, places, 2), are within a car's reach, shape (n,)."""
    offset = places - position.T[:, None]
    squared = offset[..., 0] ** 2 + offset[..., 1] ** 2
    within: np.ndarray = squared < reach[:, None] ** 2
    return within

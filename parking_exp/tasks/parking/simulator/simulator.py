"""Vectorized simulator of parking-v0: many scenes at once, exactly as highway-env simulates them,
with NumPy alone.

A policy step is a few simulation frames of constant action. Scenes without a possible contact in
the step, nearly all, are integrated at once; the others frame by frame, in highway-env's order:
limit the action, move, apply the impact of the frame before, detect collisions.
"""

from typing import Any

import numpy as np

from parking_exp.tasks.parking.geometry import (
    CAR_DIAGONAL_M,
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    OBSTACLE_M,
    WALL_HEADINGS,
    WALL_THICKNESS_M,
)
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.nearby_vehicles import nearest_vehicles
from parking_exp.tasks.parking.parking_config import DEFAULT_SCALES, ParkingConfig
from parking_exp.tasks.parking.pose import Pose, relative_pose
from parking_exp.tasks.parking.rays import ray_distances, rectangles_of
from parking_exp.tasks.parking.reward import reward_of
from parking_exp.tasks.parking.scenes import Scenes
from parking_exp.tasks.parking.simulator.collisions import Collisions, extent, walls_of
from parking_exp.tasks.parking.simulator.dynamics import (
    Range,
    advance,
    limited_acceleration,
    slip_angle,
)
from parking_exp.tasks.parking.simulator.scene_state import SceneState
from parking_exp.tasks.task import Step

# highway-env's own ranges, where the config has none: of ContinuousAction and of Vehicle.
ACCELERATION_RANGE_MPS2: Range = (-5.0, 5.0)
STEERING_RANGE_RAD: Range = (-np.pi / 4, np.pi / 4)
SPEED_RANGE_MPS: Range = (-40.0, 40.0)


class Simulator:
    """n independent scenes of an env variant, simulated together; none is ever reset by itself."""

    state: SceneState

    def __init__(self, config: ParkingConfig, scenes: Scenes) -> None:
        action = config.action
        acceleration = action.acceleration_range or ACCELERATION_RANGE_MPS2
        ranges = [acceleration, action.steering_range or STEERING_RANGE_RAD]
        self._low = np.array([low for low, _ in ranges])
        self._span = np.array([high - low for low, high in ranges])
        low, high = action.speed_range or SPEED_RANGE_MPS
        self.speed_range = (low, high)
        self.clip = action.clip
        self.frames = config.simulation_frequency // config.policy_frequency
        self.dt = 1 / config.simulation_frequency
        self.episode_steps = config.episode_steps()
        self.walls = config.add_walls
        self.reward = reward_of(config)
        self.n_seen = config.observation.vehicles_count
        self.rays = config.observation.rays
        self.rays_range_m = config.observation.rays_range_m
        self.scales = np.array(DEFAULT_SCALES, np.float64)
        self._row_m = lot_of(config).nearest_row_m
        self._collisions = Collisions(
            self.dt, config.vehicles_range[1], config.obstacles, walls=config.add_walls
        )
        sizes = scenes.vehicles.shape[1], scenes.obstacles.shape[1]
        assert sizes == (config.vehicles_range[1], config.obstacles), (
            f"scenes have {sizes} vehicles and obstacles"
        )
        self.start(scenes)

    def __len__(self) -> int:
        return len(self.state.heading)

    def start(self, scenes: Scenes, rows: np.ndarray | None = None) -> None:
        """Start anew, all scenes or the given rows."""
        if rows is None:
            self.state = SceneState.at_start(scenes)
        else:
            self.state.put(rows, SceneState.at_start(scenes))

    def keep(self, rows: np.ndarray) -> None:
        """Keep only some of the scenes, by index or mask."""
        self.state = self.state.take(np.arange(len(self))[rows])

    def observe(self, rows: np.ndarray | slice = slice(None)) -> dict[str, np.ndarray]:
        """Return the observation of all scenes, or of some."""
        pose = self._pose(rows)
        scaled = np.divide(pose, self.scales, order="C")
        seen = [scaled]
        if self.n_seen:
            seen.append(self._observe_vehicles(pose, rows))
        if self.rays:
            seen.append(self._observe_rays(pose, rows))
        return {
            "observation": np.concatenate(seen, axis=1),
            "achieved_goal": scaled,
            "desired_goal": self.state.goal_features[rows].copy(),
        }

    def _observe_vehicles(self, pose: np.ndarray, rows: np.ndarray | slice) -> np.ndarray:
        """Return what the cars see of parked cars and obstacles."""
        state = self.state
        obstacles = state.obstacles[rows]
        others = np.concatenate([state.vehicles[rows], obstacles], axis=1)
        headings = [state.vehicle_heading[rows], np.zeros(obstacles.shape[:2])]
        heading = np.concatenate(headings, axis=1)
        return nearest_vehicles(pose[:, :2], others, heading, self.n_seen)

    def _observe_rays(self, pose: np.ndarray, rows: np.ndarray | slice) -> np.ndarray:
        """Return the distances that the cars see along rays, as shares of the range."""
        state = self.state
        obstacles = state.obstacles[rows]
        parts = [
            rectangles_of(
                state.vehicles[rows], state.vehicle_heading[rows], CAR_LENGTH_M, CAR_WIDTH_M
            ),
            rectangles_of(obstacles, np.zeros(obstacles.shape[:2]), OBSTACLE_M, OBSTACLE_M),
        ]
        if self.walls:
            places, lengths = walls_of(state.free[:, rows])
            headings = np.tile(WALL_HEADINGS, (len(pose), 1))
            parts.append(rectangles_of(places, headings, lengths, WALL_THICKNESS_M))
        rectangles = np.concatenate(parts, axis=-1)
        position = pose.T[:2]
        direction = pose.T[4:]
        distances = ray_distances(position, direction, rectangles, self.rays, self.rays_range_m)
        return distances / self.rays_range_m

    def step(self, actions: np.ndarray) -> Step:
        """Drive all scenes for one policy step; actions have the shape (n, 2): acceleration, then
        steering.
        """
        state = self.state
        actions = np.asarray(actions)
        if actions.dtype.kind != "f":
            actions = actions.astype(np.float64)
        assert actions.shape == (len(self), 2), f"actions have the shape {actions.shape}"
        acceleration, steering = self.controls(actions)
        position = state.position
        heading = state.heading
        speed = state.speed
        rows = self._drive(acceleration, steering)
        if len(rows):
            part = state.take(rows)
            part.position = position[:, rows]
            part.heading = heading[rows]
            part.speed = speed[rows]
            self._drive_by_frames(part, acceleration[rows], steering[rows])
            state.put(rows, part)
        state.steps += 1
        return self._outcome()

    def ending(self, row: int) -> Pose:
        """Return the pose of a car relative to its goal."""
        state = self.state
        return relative_pose(
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
        if self.clip:
            actions = np.minimum(np.maximum(actions, -1), 1)
        # From [-1, 1] to the ranges, in the precision of the actions, as highway-env does.
        scaled = actions - -1
        scaled *= self._span.astype(actions.dtype)
        scaled /= 2
        scaled += self._low.astype(actions.dtype)
        return scaled.T.astype(np.float64)

    def _drive(self, acceleration: np.ndarray, steering: np.ndarray) -> np.ndarray:
        """Integrate all frames of a step as if there were no obstacles; return the rows where that
        may be wrong.
        """
        state = self.state
        position = state.position
        heading = state.heading
        speed = state.speed
        slip = slip_angle(steering)
        sin_slip = np.sin(slip)
        gain = acceleration * self.dt
        farthest = np.abs(position)
        for _ in range(self.frames):
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
        state.direction = _direction(heading)
        return np.flatnonzero(self._uncertain(slowest, fastest, farthest, sin_slip))

    def _uncertain(
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
        ahead = np.maximum(fastest, -slowest) * self.dt
        if self.walls:
            # At the end the car reaches this far along both axes; before, it was turned by at most
            # `turn`.
            reach = extent(state.direction)
            turn = np.abs(sin_slip) * ahead * (self.frames / (CAR_LENGTH_M / 2))
            near = farthest + reach + (ahead + turn * (CAR_DIAGONAL_M / 2)) > state.free
            uncertain |= near[0]
            uncertain |= near[1]
        reach_m = ahead * (self.frames + 1) + CAR_DIAGONAL_M
        if state.vehicles.shape[1]:
            uncertain |= self._near_vehicles(reach_m)
        if state.obstacles.shape[1]:
            uncertain |= _any_within(reach_m, state.position, state.obstacles)
        return uncertain

    def _near_vehicles(self, reach: np.ndarray) -> np.ndarray:
        """Return a mask of the scenes where a parked car is near, or has been moved."""
        state = self.state
        near: np.ndarray = state.disturbed.copy()
        close = np.flatnonzero(np.abs(state.position[1]) + reach > self._row_m)
        near[close] |= _any_within(reach[close], state.position[:, close], state.vehicles[close])
        return near

    def _drive_by_frames(
        self, state: SceneState, acceleration: np.ndarray, steering: np.ndarray
    ) -> None:
        """Integrate a step frame by frame, in place, with speed limits, collisions and their
        consequences.
        """
        low, high = self.speed_range
        fastest = np.abs(state.speed) + np.abs(acceleration) * (self.frames * self.dt)
        limited = fastest.max() > min(-low, high)
        slip = slip_angle(steering)
        sin_slip = np.sin(slip)
        for _ in range(self.frames):
            if state.crashed.any():
                slip[state.crashed] = sin_slip[state.crashed] = 0.0  # no steering, and full brakes
                acceleration = np.where(state.crashed, -state.speed, acceleration)
            if limited:
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
                impact = np.where(state.hit[..., None], state.impact, 0.0)
                state.position += impact[:, 0].T
                state.vehicles += impact[:, 1:]
                state.crashed |= state.hit[:, 0]
                state.hit[:] = False
            state.direction = _direction(state.heading)
            self._collisions.resolve(state)

    def _pose(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Return x, y, vx, vy, cos_h, sin_h of the cars, shape (n, 6), in m and m/s."""
        state = self.state
        pose = np.empty((6, len(state.heading[rows])))
        pose[:2] = state.position[:, rows]
        pose[4:] = state.direction[:, rows]
        np.multiply(state.speed[rows], pose[4:], out=pose[2:4])
        return pose.T

    def _outcome(self) -> Step:
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


def _any_within(reach: np.ndarray, position: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return whether any of the places, shape (n, places, 2), is within a car's reach, shape
    (n,).
    """
    offset = places - position.T[:, None]
    squared = offset[..., 0] ** 2 + offset[..., 1] ** 2
    return (squared < reach[:, None] ** 2).any(axis=1)


def _direction(heading: np.ndarray) -> np.ndarray:
    direction = np.empty((2, len(heading)))
    np.cos(heading, out=direction[0])
    np.sin(heading, out=direction[1])
    return direction

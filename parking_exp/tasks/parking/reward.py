"""Goal rewards of many goals at once, without the collision term: highway-env's, other lots'."""

import numpy as np

from parking_exp.tasks.parking.geometry import in_frame
from parking_exp.tasks.parking.parking_config import (
    DEFAULT_FEATURES,
    DEFAULT_SCALES,
    ParkingConfig,
)
from parking_exp.tasks.parking.pose import PARKED_SPEED_MPS, is_parked
from parking_exp.tasks.task import GoalReward


class ParkingReward(GoalReward):
    """The reward of an env variant; goals are x, y, vx, vy, cos_h, sin_h in highway-env's scale.

    Attributes:
        weights: of the features' distances, shape (6,).
        threshold: the dense reward above which a goal counts as reached.
        failure_penalty: what a crash adds to the reward.
        sparse: whether the reward is 0 where the goal is reached and -1 elsewhere, instead of the
            distance.
        standing_reward: added where the car stands outside its slot; `LotReward` only.
    """

    failure_key = "crashed"
    # Which features of a goal are a velocity.
    velocity = tuple(DEFAULT_FEATURES.index(name) for name in ("vx", "vy"))

    def __init__(self, config: ParkingConfig) -> None:
        self.weights = np.array(config.reward_weights, np.float64)
        self.threshold = -config.success_goal_reward
        self.failure_penalty = config.collision_reward
        self.sparse = config.reward == "sparse"
        self.standing_reward = config.standing_reward

    def __call__(
        self, achieved: np.ndarray, desired: np.ndarray, info: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return reward and whether the goal is reached, shape (...), for goals of (..., 6)."""
        # The negative square root of the weighted distance, by a dot product as in highway-env.
        dense: np.ndarray = -np.sqrt(np.vecdot(np.abs(achieved - desired), self.weights))
        reached = dense > self.threshold
        if self.sparse:
            return np.where(reached, 0.0, -1.0), reached
        return dense, reached


class LotReward(ParkingReward):
    """The reward of other lots than highway-env's, in the slot's frame; success is `parked`.

    The six weights are for the distances along and across the slot, the velocities along and across
    it, and 1 minus the cosine, and the sine, of the heading relative to the slot. So the angle of a
    slot does not matter. A car that is not parked gets `standing_reward` at a speed of 0. It gets
    less at higher speeds, and nothing from 0.5 m/s on.
    """

    info_keys = ("slot_length_m", "slot_width_m")

    def __call__(
        self, achieved: np.ndarray, desired: np.ndarray, info: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return reward and whether the car is parked, both of shape (...).

        Args:
            achieved, desired: goals, shape (..., 6).
            info: length and width of the slots, shape (..., 2) [m].
        """
        assert info is not None, "the size of the slot decides whether a car is parked"
        slot = (desired[..., 4], desired[..., 5])
        x, y, vx, vy = np.moveaxis(achieved[..., :4] - desired[..., :4], -1, 0)
        ahead, side = in_frame((x, y), slot)  # in units of the observation, as the velocities
        cos_error, sin_error = in_frame((achieved[..., 4], achieved[..., 5]), slot)
        parked = np.asarray(
            is_parked(
                ahead * DEFAULT_SCALES[0],
                side * DEFAULT_SCALES[1],
                np.arctan2(sin_error, cos_error),
                np.sqrt(vx * vx + vy * vy) * DEFAULT_SCALES[2],
                info[..., 0],
                info[..., 1],
            )
        )

        if self.sparse:
            reward = np.where(parked, 0.0, -1.0)
        else:
            velocities = in_frame((vx, vy), slot)
            distances = np.stack([ahead, side, *velocities, 1.0 - cos_error, sin_error], axis=-1)
            reward = -np.sqrt(np.vecdot(np.abs(distances), self.weights))

        if self.standing_reward:
            reward = reward + self._standing_reward(achieved) * ~parked
        return reward, parked

    def _standing_reward(self, achieved: np.ndarray) -> np.ndarray:
        """Return the reward for standing, shape (...).

        It depends on the car's own speed, not on its speed relative to a virtual goal, which may
        move.
        """
        vx, vy = np.moveaxis(achieved[..., 2:4], -1, 0)
        speed_mps = np.sqrt(vx * vx + vy * vy) * DEFAULT_SCALES[2]
        slowness: np.ndarray = np.maximum(0.0, 1.0 - speed_mps / PARKED_SPEED_MPS)
        return self.standing_reward * slowness


def reward_of(config: ParkingConfig) -> ParkingReward:
    """Return the reward of an `env` group."""
    if config.lot_configs:
        return LotReward(config)
    return ParkingReward(config)

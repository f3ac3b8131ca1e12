"""Goal reward of highway-env without the collision term, for many goals at once."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from parking_exp.tasks.parking.parking_config import DEFAULT_FEATURES, ParkingConfig


@dataclass(frozen=True, eq=False)
class ParkingReward:
    """The reward of an env variant. Goals are x, y, vx, vy, cos_h, sin_h in highway-env's own
    scales.
    """

    weights: np.ndarray  # of the features' distances, shape (6,)
    threshold: float  # the dense reward above which a goal counts as reached
    failure_penalty: float  # what a crash adds to the reward
    # Whether the reward is 0 where the goal is reached and -1 elsewhere, instead of the distance.
    sparse: bool

    failure_key = "crashed"
    info_keys = ()
    terminates = True
    # Which features of a goal are a velocity.
    velocity = tuple(DEFAULT_FEATURES.index(name) for name in ("vx", "vy"))

    @classmethod
    def of(cls, config: ParkingConfig) -> Self:
        """Return the reward of an `env` group."""
        return cls(
            weights=np.array(config.reward_weights, np.float64),
            threshold=-config.success_goal_reward,
            failure_penalty=config.collision_reward,
            sparse=config.reward == "sparse",
        )

    def __call__(
        self, achieved: np.ndarray, desired: np.ndarray, info: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return reward and whether the goal is reached, both of shape (...) for goals of shape
        (..., 6).
        """
        # The negative square root of the weighted distance, by a dot product as in highway-env.
        dense: np.ndarray = -np.sqrt(np.vecdot(np.abs(achieved - desired), self.weights))
        reached = dense > self.threshold
        if self.sparse:
            return np.where(reached, 0.0, -1.0), reached
        return dense, reached

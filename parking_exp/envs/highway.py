"""parking-v0 as highway-env simulates it."""

from typing import Any

import gymnasium as gym
import highway_env
import numpy as np

from parking_exp.config import EnvConfig

gym.register_envs(highway_env)


class SparseReward(gym.Wrapper, gym.utils.RecordConstructorArgs):
    """Replace the goal reward by 0 on success and -1 otherwise (Andrychowicz et al. 2017, section 4).

    Success stays what highway-env calls success, and `collision_reward` is still added to the step of a crash.
    """

    def __init__(self, env: gym.Env) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)  # so that gymnasium can make the env again from its spec
        gym.Wrapper.__init__(self, env)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the env; the reward is 0 or -1, plus the penalty of a collision."""
        observation, _, terminated, truncated, info = self.env.step(action)
        reward = self.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
        reward = float(reward) + self.unwrapped.config["collision_reward"] * info["crashed"]
        return observation, reward, terminated, truncated, info

    def compute_reward(self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: object) -> np.ndarray:
        """Return 0 where the goal is reached and -1 elsewhere; goals of shape (6,) or (batch, 6)."""
        base = self.unwrapped
        dense = base.compute_reward(achieved_goal, desired_goal, info)
        return np.where(dense > -base.config["success_goal_reward"], 0.0, -1.0)


def make_env(config: EnvConfig, *, training: bool = False, render_mode: str | None = None) -> gym.Env:
    """Make one parking env.

    Args:
        config: the `env` group.
        training: whether episodes last `training_duration` instead of `duration`.
        render_mode: None or `rgb_array`.
    """
    # Gymnasium's checker tests every space at every step and costs time; our tests run it instead.
    env = gym.make(
        config.id, config=config.highway_options(training), render_mode=render_mode, disable_env_checker=True
    )
    return SparseReward(env) if config.reward == "sparse" else env

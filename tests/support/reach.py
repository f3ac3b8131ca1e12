"""A toy goal environment in which only an agent that looks at the goal succeeds more often than by
chance.
"""

import gymnasium as gym
import numpy as np

from parking_exp.tasks.task import GoalReward

DIMENSIONS, TOLERANCE, STRIDE, STEPS = 4, 0.1, 0.25, 10
CHANCE = STEPS * TOLERANCE**DIMENSIONS
"""Upper bound of the success rate of an agent that does not look at the goal: 0.1 %.

The goal is uniform in a cube of side 2 and independent of such an agent's path. Each of the STEPS
points on it is near enough with a probability of at most (2 * TOLERANCE / 2) ** DIMENSIONS.
"""


class ReachReward(GoalReward):
    """Reward of a step of `Reach` with a goal, and whether it is reached."""

    def __call__(self, achieved, desired, info=None):
        reached = np.abs(achieved - desired).max(axis=-1) <= TOLERANCE
        return np.where(reached, 0.0, -1.0), reached


class Reach(gym.Env):
    """A point in a cube of side 2 that must come within TOLERANCE of a goal, in each coordinate,
    within STEPS steps.

    Every goal can be reached: coordinates differ by at most 2, which is 8 steps of STRIDE. The
    reward is 0 at the goal, where the episode ends, and -1 elsewhere.
    """

    observation_space = gym.spaces.Dict(
        {
            key: gym.spaces.Box(-1, 1, (DIMENSIONS,), np.float64)
            for key in ("observation", "achieved_goal", "desired_goal")
        }
    )
    action_space = gym.spaces.Box(-1, 1, (DIMENSIONS,), np.float32)
    goal_reward = ReachReward()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.point, self.goal = self.np_random.uniform(-1, 1, (2, DIMENSIONS))
        self.steps = 0
        return self._observe(), {}

    def step(self, action):
        self.point = np.clip(self.point + STRIDE * np.asarray(action, dtype=float), -1, 1)
        self.steps += 1
        reward, reached = self.goal_reward(self.point, self.goal)
        is_over = self.steps >= STEPS
        return self._observe(), float(reward), bool(reached), is_over, {"is_success": reached}

    def _observe(self):
        return {
            "observation": self.point.copy(),
            "achieved_goal": self.point.copy(),
            "desired_goal": self.goal.copy(),
        }


def success_rate(policy, episodes=200):
    """Share of episodes in which a policy reaches the goal; always the same episodes."""
    env, successes = Reach(), 0
    for seed in range(episodes):
        observation, info = env.reset(seed=seed)
        done = False
        while not done:
            action = policy({key: value[None] for key, value in observation.items()})[0]
            observation, _, terminated, truncated, info = env.step(action)
            done = terminated or truncated
        successes += info["is_success"]
    return successes / episodes

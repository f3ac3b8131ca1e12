"""A toy task in which only an agent that looks at the goal succeeds more often than by chance."""

import numpy as np
from gymnasium.spaces import Box, Dict

from parking_exp.tasks.vectorized_task import VectorizedTask

DIMENSIONS = 4
TOLERANCE = 0.1
STRIDE = 0.25
STEPS = 10
CHANCE = STEPS * TOLERANCE**DIMENSIONS
"""Upper bound of the success rate of an agent that does not look at the goal: 0.1 %.

The goal is uniform in a cube of side 2 and independent of such an agent's path. Each of the STEPS
points on it is near enough with a probability of at most (2 * TOLERANCE / 2) ** DIMENSIONS.
"""
CUBE = Box(-1, 1, (DIMENSIONS,), np.float64)


class Reach(VectorizedTask):
    """A point in a cube of side 2 that must come within TOLERANCE of a goal, in each coordinate,
    within STEPS steps.

    Every goal can be reached: coordinates differ by at most 2, which is 8 steps of STRIDE. The
    reward is 0 at the goal, where the episode ends, and -1 elsewhere.
    """

    observation_space = Dict(observation=CUBE, achieved_goal=CUBE, desired_goal=CUBE)
    action_space = Box(-1, 1, (DIMENSIONS,), np.float32)
    episode_steps = STEPS

    def start(self, seeds):
        places = [np.random.default_rng(seed).uniform(-1, 1, (2, DIMENSIONS)) for seed in seeds]
        point, goal = np.stack(places, axis=1)
        return {"point": point, "goal": goal}

    def observe(self, state):
        return {
            "observation": state["point"],
            "achieved_goal": state["point"],
            "desired_goal": state["goal"],
        }

    def step(self, state, actions):
        point = np.clip(state["point"] + STRIDE * actions, -1, 1)
        return {"point": point, "goal": state["goal"]}

    def reward(self, achieved, desired):
        reached = np.abs(achieved - desired).max(axis=-1) <= TOLERANCE
        return np.where(reached, 0.0, -1.0), reached

"""Tasks of arrays as users write them: one that works, and some that do not."""

import numpy as np
from gymnasium.spaces import Box, Dict

from parking_exp.tasks.task import Task
from parking_exp.tasks.vectorized_task import VectorizedTask

OPTION = """\
# @package _global_
defaults:
  - shared/goal_task
  - _self_
env:
  task: {task}
  name: steps
  kwargs: {{}}
"""
LINE = Box(-9, 9, (1,), np.float64)


class Steps(VectorizedTask):
    """A point on a line that starts at its seed % 4, moves by its action, and has the goal 3.

    Its state is returned as the observation, and its arrays are kept: the batch has to copy them.
    """

    observation_space = Dict(observation=LINE, achieved_goal=LINE, desired_goal=LINE)
    action_space = Box(-1, 1, (1,), np.float32)
    episode_steps = 5

    def __init__(self, left_edge=-1.0):
        self.left_edge = left_edge

    def start(self, seeds):
        at = np.array(seeds, float).reshape(-1, 1) % 4
        return {"at": at, "goal": np.full_like(at, 3.0)}

    def observe(self, state):
        return {
            "observation": state["at"],
            "achieved_goal": state["at"],
            "desired_goal": state["goal"],
        }

    def step(self, state, actions):
        return {"at": state["at"] + actions, "goal": state["goal"]}

    def reward(self, achieved, desired):
        distance = np.abs(achieved - desired)[:, 0]
        return -distance, distance == 0

    def failed(self, state):
        return state["at"][:, 0] < self.left_edge


def write_option(folder, task):
    """Write the option `env=steps` of a task, and return the folder of options."""
    (folder / "env").mkdir(parents=True, exist_ok=True)
    (folder / "env" / "steps.yaml").write_text(OPTION.format(task=task))
    return folder


class FlatReward(Steps):
    def reward(self, achieved, desired):
        return super().reward(achieved, desired)[0].sum(), np.zeros(len(achieved), bool)


class NoGoal(Steps):
    def observe(self, state):
        return {"observation": state["at"]}


class Unfinished(VectorizedTask):
    """Lacks all methods."""


class Unknown:
    """Is no task."""


class OwnEnvs(Task):
    """Lacks evaluations and the length of episodes."""

    def training_envs(self, n_envs):
        raise NotImplementedError

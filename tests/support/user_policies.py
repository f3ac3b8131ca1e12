"""Policies as users write them, which are not trained, and a task for them."""

import numpy as np
from gymnasium.spaces import Box

from parking_exp.buffers import HerBuffer
from parking_exp.tasks.scripted_policy import ScriptedPolicy
from support.user_tasks import Steps


class LongSteps(Steps):
    """Steps of up to 2."""

    action_space = Box(-2, 2, (1,), np.float32)


class Walker(ScriptedPolicy):
    """Goes to the goal by steps of up to `stride`."""

    def __init__(self, task, seed, stride=1.0):
        super().__init__(task, seed)
        self.stride = stride
        self.n_episodes = 0

    def start(self, seeds, on_progress=None):
        self.n_episodes = len(seeds)

    def __call__(self, observation):
        way = observation["desired_goal"] - observation["achieved_goal"]
        assert len(way) == self.n_episodes
        return np.clip(way, -self.stride, self.stride)

    def keep(self, rows):
        self.n_episodes = int(rows.sum())


class OwnSample(HerBuffer):
    """Draws batches in its own way."""

    def sample(self, batch_size, env=None):
        return self._sample(batch_size)

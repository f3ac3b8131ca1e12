"""Policies as users write them, which are not trained, and a task for them."""

from itertools import compress

import numpy as np
from gymnasium.spaces import Box

from parking_exp.buffers import HerBuffer
from parking_exp.tasks.scripted_policy import ScriptedPolicy
from parking_exp.tasks.task import Policy
from support.toy_tasks import BITS, BitFlip
from support.user_tasks import Steps


class FunctionPolicy(Policy):
    """The policy that a function of observations is."""

    def __init__(self, function):
        self.function = function

    def __call__(self, observation):
        return self.function(observation)


def constant(*action):
    """The policy with the same action in all states."""
    return FunctionPolicy(lambda seen: np.tile(action, (len(seen["observation"]), 1)))


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


class Flipper(ScriptedPolicy):
    """Solves `BitFlip` by plans: from the seeds, it knows which bits are wrong."""

    def start(self, seeds, on_progress=None):
        env = BitFlip()
        self.plans = []
        for seed in seeds:
            bits, _ = env.reset(seed=seed)
            wrong = bits["achieved_goal"] != bits["desired_goal"]
            self.plans.append(np.flatnonzero(wrong).tolist())

    def __call__(self, observation):
        flipped = [plan.pop(0) for plan in self.plans]
        return np.eye(BITS)[flipped]

    def keep(self, rows):
        self.plans = list(compress(self.plans, rows))


class OwnSample(HerBuffer):
    """Draws batches in its own way."""

    def sample(self, batch_size, env=None):
        return self._sample(batch_size)

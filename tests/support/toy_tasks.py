"""Toy goal environments as a user's own package: `toy_tasks:BitFlip-v0` and some that are
refused.
"""

import multiprocessing
import os

import gymnasium as gym
import numpy as np

BITS = 8


class BitFlip(gym.Env):
    """Flip bits until they equal the goal (Andrychowicz et al. 2017, section 3.1), one bit per
    step.

    The action has a number for each bit; the bit with the largest one is flipped. The reward is 0
    at the goal, where the episode ends, and -1 elsewhere.
    """

    observation_space = gym.spaces.Dict(
        {
            key: gym.spaces.Box(0, 1, (BITS,), np.float64)
            for key in ("observation", "achieved_goal", "desired_goal")
        }
    )
    action_space = gym.spaces.Box(-1, 1, (BITS,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.bits, self.goal = self.np_random.integers(2, size=(2, BITS)).astype(float)
        return self._observe(), {}

    def step(self, action):
        flipped = int(np.argmax(action))
        self.bits[flipped] = 1 - self.bits[flipped]
        reward = float(self.compute_reward(self.bits, self.goal, {}))
        return (
            self._observe(),
            reward,
            reward == 0,
            False,
            {"is_success": reward == 0, "lost": False},
        )

    def compute_reward(self, achieved_goal, desired_goal, info):
        return np.where((achieved_goal == desired_goal).all(axis=-1), 0.0, -1.0)

    def compute_terminated(self, achieved_goal, desired_goal, info):
        return bool((achieved_goal == desired_goal).all())

    def _observe(self):
        return {
            "observation": self.bits.copy(),
            "achieved_goal": self.bits.copy(),
            "desired_goal": self.goal.copy(),
        }


class OneByOne(BitFlip):
    """`compute_reward` takes one goal only."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        return 0.0 if np.array_equal(achieved_goal, desired_goal) else -1.0


class OtherReward(BitFlip):
    """`compute_reward` does not know what a step costs."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward - 0.5, terminated, truncated, info


class Priced(BitFlip):
    """Each step has a price of its own, which only `info` has."""

    def step(self, action):
        observation, _, terminated, truncated, info = super().step(action)
        info["price"] = float(self.np_random.uniform())
        reward = self.compute_reward(
            observation["achieved_goal"], observation["desired_goal"], info
        )
        return observation, float(reward), terminated, truncated, info

    def compute_reward(self, achieved_goal, desired_goal, info):
        infos = [info] if isinstance(info, dict) else info
        price = np.array([entry.get("price", 0.0) for entry in infos])
        return np.squeeze(super().compute_reward(achieved_goal, desired_goal, info) - price)


class Worded(Priced):
    """`compute_reward` needs an entry of `info` that is no number."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        infos = [info] if isinstance(info, dict) else info
        malus = np.array([2.0 * (entry.get("word") == "wrong") for entry in infos])
        return np.squeeze(BitFlip.compute_reward(self, achieved_goal, desired_goal, info) - malus)

    def step(self, action):
        observation, _, terminated, truncated, info = BitFlip.step(self, action)
        info["word"] = "wrong"
        reward = self.compute_reward(
            observation["achieved_goal"], observation["desired_goal"], info
        )
        return observation, float(reward), terminated, truncated, info


class Drawn(BitFlip):
    """It renders: a column of 10 pixels for each bit."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def render(self):
        return np.repeat(
            np.broadcast_to((255 * self.bits).astype(np.uint8)[None, :, None], (40, BITS, 3)),
            10,
            axis=1,
        )


class Unseeded(BitFlip):
    """Its steps are not reproducible."""

    def step(self, action):
        return super().step(np.random.default_rng().uniform(-1, 1, BITS))


class Silent(BitFlip):
    """`info` does not say whether the goal is reached."""

    def step(self, action):
        return (*super().step(action)[:4], {})


class Broken(BitFlip):
    """It cannot be made."""

    def __init__(self):
        raise RuntimeError("no licence\nfound")


class Discrete(BitFlip):
    """Its actions are numbers of bits."""

    action_space = gym.spaces.Discrete(BITS)


class Blank(Drawn):
    """It renders nothing, such as EGL without a display."""

    def render(self):
        return None


class LosesContext(Drawn):
    """Rendering fails after three frames."""

    n_frames = 0

    def render(self):
        self.n_frames += 1
        if self.n_frames > 3:
            raise RuntimeError("GL context lost")
        return super().render()


class CloseFails(BitFlip):
    """Its server is gone when it is closed."""

    def close(self):
        raise RuntimeError("Not connected to physics server.")


class OwnGoal(BitFlip):
    """`compute_reward` looks at the goal that the environment keeps."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        return super().compute_reward(achieved_goal, self.goal, info)


class NoReward(gym.Env):
    """`BitFlip`, without its `compute_reward`."""

    observation_space, action_space = BitFlip.observation_space, BitFlip.action_space

    def __init__(self):
        self.bit_flip = BitFlip()

    def reset(self, *, seed=None, options=None):
        return self.bit_flip.reset(seed=seed)

    def step(self, action):
        return self.bit_flip.step(action)


class RewardWrapper(gym.Wrapper):
    """`compute_reward` is on the wrapper, where Stable-Baselines3 finds it."""

    compute_reward, compute_terminated = BitFlip.compute_reward, BitFlip.compute_terminated


class SmallSeeds(BitFlip):
    """Its seeds have 31 bits."""

    def reset(self, *, seed=None, options=None):
        if seed is not None and seed >= 2**31:
            raise OverflowError("Python int too large to convert to C int")
        return super().reset(seed=seed)


class IntegerActions(BitFlip):
    """Its actions are integers."""

    action_space = gym.spaces.Box(-5, 5, (BITS,), np.int64)


class Counted(BitFlip):
    """It counts how many of its kind there are at once."""

    n_open, n_most = 0, 0

    def __init__(self):
        Counted.n_open += 1
        Counted.n_most = max(Counted.n_open, Counted.n_most)

    def close(self):
        Counted.n_open -= 1


class Exits(BitFlip):
    """Its process ends in the first step, unless that is the one of the tests."""

    def step(self, action):
        if multiprocessing.parent_process() is not None:
            os._exit(1)
        return super().step(action)


def wrapped_bit_flip():
    return RewardWrapper(NoReward())


REFUSED = (OneByOne, OtherReward, Silent, Broken, Discrete, Worded, OwnGoal, IntegerActions)
QUIRKY = (Blank, LosesContext, CloseFails, SmallSeeds, Counted, Exits)
for cls in (BitFlip, Priced, Unseeded, Drawn, *REFUSED, *QUIRKY):
    gym.register(f"{cls.__name__}-v0", cls, max_episode_steps=BITS)
gym.register("Endless-v0", BitFlip)
gym.register("Wrapped-v0", wrapped_bit_flip, max_episode_steps=BITS)

"""Toy goal environments as a user's own package: `toy_tasks:BitFlip-v0`, a point in the plane, and
their quirks, some of which are refused.
"""

import multiprocessing
import os
import sys

import gymnasium as gym
import numpy as np

BITS = 8
PLANE_STEPS = 20


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
        is_success = self.compute_terminated(self.bits, self.goal, {})
        info = {"is_success": is_success, "lost": False, **self.own_info()}
        reward = float(self.compute_reward(self.bits, self.goal, info))
        return self._observe(), reward, is_success, False, info

    def own_info(self):
        return {}

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


class ColumnReward(BitFlip):
    """For many goals `compute_reward` returns a column."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        reward = super().compute_reward(achieved_goal, desired_goal, info)
        return reward[:, np.newaxis] if reward.ndim else reward


class OtherReward(BitFlip):
    """`compute_reward` does not know what a step costs."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward - 0.5, terminated, truncated, info


class Priced(BitFlip):
    """Each step has a price of its own, which only `info` has."""

    def own_info(self):
        return {"price": float(self.np_random.uniform())}

    def price(self, info):
        return info.get("price", 0.0)

    def compute_reward(self, achieved_goal, desired_goal, info):
        infos = [info] if isinstance(info, dict) else info
        prices = np.array([self.price(entry) for entry in infos])
        return np.squeeze(super().compute_reward(achieved_goal, desired_goal, info) - prices)


class Worded(Priced):
    """`compute_reward` needs an entry of `info` that is no number."""

    def own_info(self):
        return {"word": "wrong"}

    def price(self, info):
        return 2.0 * (info.get("word") == "wrong")


class InfoArray(Priced):
    """`compute_reward` takes one info or an array of them, no list."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        if isinstance(info, list):
            raise TypeError("infos are an array")
        return super().compute_reward(achieved_goal, desired_goal, info)


class OwnGoal(BitFlip):
    """`compute_reward` looks at the goal that the environment keeps."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        return super().compute_reward(achieved_goal, self.goal, info)


class AnyBits(BitFlip):
    """`compute_reward` ignores the achieved goal that it is given."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        return super().compute_reward(np.clip(desired_goal, 0, 1), desired_goal, info)


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


class IntegerActions(BitFlip):
    """Its actions are integers."""

    action_space = gym.spaces.Box(-5, 5, (BITS,), np.int64)


class NoReward(gym.Env):
    """`BitFlip`, without its `compute_reward`."""

    observation_space = BitFlip.observation_space
    action_space = BitFlip.action_space

    def __init__(self):
        self.bit_flip = BitFlip()

    def reset(self, *, seed=None, options=None):
        return self.bit_flip.reset(seed=seed)

    def step(self, action):
        return self.bit_flip.step(action)


class RewardWrapper(gym.Wrapper):
    """`compute_reward` is on the wrapper, where Stable-Baselines3 finds it."""

    compute_reward = BitFlip.compute_reward
    compute_terminated = BitFlip.compute_terminated


def wrapped_bit_flip():
    return RewardWrapper(NoReward())


class SmallSeeds(BitFlip):
    """Its seeds have 31 bits."""

    def reset(self, *, seed=None, options=None):
        if seed is not None and seed >= 2**31:
            raise OverflowError("Python int too large to convert to C int")
        return super().reset(seed=seed)


class CloseFails(BitFlip):
    """Its server is gone when it is closed."""

    def close(self):
        raise RuntimeError("Not connected to physics server.")


class Counted(BitFlip):
    """It counts how many of its kind there are at once."""

    n_open = 0
    n_most = 0

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


class Drawn(BitFlip):
    """It renders: a column of 10 pixels for each bit."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012
    n_frames = 0

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def render(self):
        self.n_frames += 1
        return np.repeat(
            np.broadcast_to((255 * self.bits).astype(np.uint8)[None, :, None], (40, BITS, 3)),
            10,
            axis=1,
        )


class Blank(Drawn):
    """It renders nothing, such as EGL without a display."""

    def render(self):
        return None


class LosesContext(Drawn):
    """Rendering fails after three frames."""

    def render(self):
        if self.n_frames == 3:
            raise RuntimeError("GL context lost")
        return super().render()


class ChangingFrames(Drawn):
    """Each frame is wider than the one before."""

    def render(self):
        return np.repeat(super().render(), self.n_frames, axis=1)


class RenderExit(Drawn):
    """Rendering ends the process."""

    def render(self):
        sys.exit(3)


class Plane(gym.Env):
    """A point that moves in the plane to its goal: the reward is 0 near it and -1 elsewhere."""

    tolerance = 0.3
    steps = 0  # in the life of this instance

    def __init__(self):
        box = gym.spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.observation_space = gym.spaces.Dict(
            observation=box, achieved_goal=box, desired_goal=box
        )
        self.action_space = gym.spaces.Box(-1, 1, (2,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = np.zeros(2, np.float32)
        self.goal = self.np_random.uniform(-1, 1, 2).astype(np.float32)
        return self.observe(), {}

    def observe(self):
        return {
            "observation": self.position,
            "achieved_goal": self.position,
            "desired_goal": self.goal,
        }

    def step(self, action):
        self.steps += 1
        moved = self.position + 0.2 * np.asarray(action)
        self.position = moved.clip(-1.5, 1.5).astype(np.float32)
        reward = float(self.compute_reward(self.position, self.goal, {}))
        return self.observe(), reward, False, False, {"is_success": reward == 0}

    def compute_reward(self, achieved_goal, desired_goal, info):
        distance = np.linalg.norm(achieved_goal - desired_goal, axis=-1)
        return -(distance > self.tolerance).astype(float)


class AlwaysThere(Plane):
    """Random steps never leave the goal, which is large."""

    tolerance = 10


class NeverThere(Plane):
    """Random steps never reach the goal, which is small."""

    tolerance = 1e-5


class NotFinite(Plane):
    """A part of its steps is not finite from step 150 of an instance on."""

    def __init__(self, part="observation"):
        super().__init__()
        self.part = part

    def step(self, action):
        observation, reward, *rest = super().step(action)
        if self.steps >= 150 and self.part == "reward":
            reward = np.inf
        elif self.steps >= 150:
            observation = {**observation, self.part: np.full(2, np.nan, np.float32)}
        return observation, reward, *rest


class LastNotFinite(NotFinite):
    """Only the last observation of an episode is not finite."""

    def step(self, action):
        is_last = (self.steps + 1) % PLANE_STEPS == 0
        if is_last:
            return super().step(action)
        return Plane.step(self, action)


class Signed(Plane):
    """Its observation has a further entry called `goal`: the sign of its actions."""

    def __init__(self):
        super().__init__()
        sign = gym.spaces.Box(-1, 1, (1,), np.float32)
        self.observation_space = gym.spaces.Dict({**self.observation_space, "goal": sign})

    def reset(self, *, seed=None, options=None):
        self.sign = 1.0
        super().reset(seed=seed)
        self.sign = float(self.np_random.choice([-1.0, 1.0]))
        return self.observe(), {}

    def observe(self):
        return {**super().observe(), "goal": np.array([self.sign], np.float32)}

    def step(self, action):
        return super().step(np.asarray(action) * self.sign)


def classes_from(cls):
    """A class and all that derive from it."""
    classes = [cls]
    for derived in cls.__subclasses__():
        classes += classes_from(derived)
    return classes


for cls in classes_from(BitFlip):
    gym.register(f"{cls.__name__}-v0", cls, max_episode_steps=BITS)
for cls in classes_from(Plane):
    gym.register(f"{cls.__name__}-v0", cls, max_episode_steps=PLANE_STEPS)
gym.register("Endless-v0", BitFlip)
gym.register("Wrapped-v0", wrapped_bit_flip, max_episode_steps=BITS)

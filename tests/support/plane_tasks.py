"""A point that moves in the plane to its goal, and environments around it as people write them."""

import sys

import gymnasium as gym
import numpy as np
from gymnasium import spaces

EPISODE = 20


class Plane(gym.Env):
    """The point and its goal, without rewards."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012

    def __init__(self, render_mode=None):
        plane = spaces.Box(-np.inf, np.inf, (2,), np.float32)
        self.render_mode = render_mode
        self.observation_space = spaces.Dict(
            observation=plane, achieved_goal=plane, desired_goal=plane
        )
        self.action_space = spaces.Box(-1, 1, (2,), np.float32)
        self.steps = 0  # in the life of this instance

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
        self.position = (
            (self.position + 0.2 * np.asarray(action)).clip(-1.5, 1.5).astype(np.float32)
        )
        return self.observe(), 0.0, False, False, {}

    def render(self):
        return np.zeros((64, 64, 3), np.uint8)


class ReachPlane(Plane):
    """The reward is 0 near the goal and -1 elsewhere."""

    def step(self, action):
        observation, _, terminated, truncated, info = super().step(action)
        reward = float(
            self.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
        )
        return observation, reward, terminated, truncated, {**info, "is_success": reward == 0}

    def compute_reward(self, achieved_goal, desired_goal, info):
        return -(np.linalg.norm(achieved_goal - desired_goal, axis=-1) > 0.3).astype(float)


class LateRenderError(ReachPlane):
    def render(self):
        if self.steps >= 5:
            raise RuntimeError("GL context lost")
        return super().render()


class ChangingFrames(ReachPlane):
    def render(self):
        return np.zeros((64 + self.steps, 64, 3), np.uint8)


class RenderExit(ReachPlane):
    def render(self):
        sys.exit(3)


class InfoArray(ReachPlane):
    """`compute_reward` takes one info or an array of them, no list."""

    def step(self, action):
        observation, _, terminated, truncated, info = super().step(action)
        info["at_wall"] = bool(np.abs(self.position).max() > 0.5)
        reward = float(
            self.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
        )
        return observation, reward, terminated, truncated, info

    def compute_reward(self, achieved_goal, desired_goal, info):
        reward = super().compute_reward(achieved_goal, desired_goal, info)
        if isinstance(info, np.ndarray):
            return reward - 5.0 * np.array([entry["at_wall"] for entry in info])
        return reward - 5.0 * info.get("at_wall", False)


class ColumnReward(ReachPlane):
    """For many goals `compute_reward` returns a column."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        reward = super().compute_reward(achieved_goal, desired_goal, info)
        return reward[:, np.newaxis] if reward.ndim else reward


class NotFinite(ReachPlane):
    """A part of its steps is not finite from step 150 of an instance on."""

    def __init__(self, render_mode=None, part="observation"):
        super().__init__(render_mode)
        self.part = part

    def step(self, action):
        observation, reward, *rest = super().step(action)
        if self.steps >= 150 and self.part == "reward":
            reward = np.inf
        elif self.steps >= 150:
            observation = {**observation, self.part: np.full(2, np.nan, np.float32)}
        return observation, reward, *rest


class LastNotFinite(ReachPlane):
    """Only the last observation of an episode is not finite."""

    def step(self, action):
        observation, *rest = super().step(action)
        if self.steps >= 150 and self.steps % EPISODE == 0:
            observation = {**observation, "observation": np.full(2, np.nan, np.float32)}
        return observation, *rest


class Signed(ReachPlane):
    """Its observation has a further entry called `goal`: the sign of its actions."""

    def __init__(self, render_mode=None):
        super().__init__(render_mode)
        entries = dict(self.observation_space.spaces, goal=spaces.Box(-1, 1, (1,), np.float32))
        self.observation_space = spaces.Dict(entries)

    def reset(self, *, seed=None, options=None):
        self.sign = 1.0
        super().reset(seed=seed)
        self.sign = float(self.np_random.choice([-1.0, 1.0]))
        return self.observe(), {}

    def observe(self):
        return {**super().observe(), "goal": np.array([self.sign], np.float32)}

    def step(self, action):
        return super().step(np.asarray(action) * self.sign)


class OwnPosition(ReachPlane):
    """`compute_reward` ignores the achieved goal that it is given."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        distance = np.linalg.norm(desired_goal, axis=-1)
        return -(distance > 0.3).astype(float)


class AlwaysThere(ReachPlane):
    """Random steps never leave the goal, which is large."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        return -(np.linalg.norm(achieved_goal - desired_goal, axis=-1) > 10).astype(float)


class NeverThere(ReachPlane):
    """Random steps never reach the goal, which is small."""

    def compute_reward(self, achieved_goal, desired_goal, info):
        return -(np.linalg.norm(achieved_goal - desired_goal, axis=-1) > 1e-5).astype(float)


CASES = (
    ReachPlane,
    LateRenderError,
    ChangingFrames,
    RenderExit,
    InfoArray,
    ColumnReward,
    NotFinite,
    LastNotFinite,
    Signed,
    OwnPosition,
    AlwaysThere,
    NeverThere,
)
for case in CASES:
    gym.register(f"{case.__name__}-v0", case, max_episode_steps=EPISODE)

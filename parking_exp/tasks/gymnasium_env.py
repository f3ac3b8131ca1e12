"""Goal environments of Gymnasium from a config, with the `info` and reward that HER needs."""

import importlib
import importlib.util
import io
import sys
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from functools import cached_property, partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from parking_exp.errors import ConfigError, class_and_message
from parking_exp.phrases import suggestion
from parking_exp.tasks.gymnasium_config import SUCCESS_KEYS, GymnasiumConfig
from parking_exp.tasks.task import GoalReward

# How ids of gymnasium-robotics begin.
ROBOTICS = (
    "Fetch",
    "Hand",
    "PointMaze",
    "AntMaze",
    "FrankaKitchen",
    "Adroit",
)
RANDOM_STEPS = 60  # at least; see `random_steps`
MAX_RANDOM_STEPS = 1_000
NUMBERS = (bool, int, float, np.number, np.bool_)


class RandomSteps(NamedTuple):
    """n random steps of an environment.

    Attributes:
        achieved, desired: goals, shape (n, size of a goal).
        rewards: shape (n,).
        infos: the `info` of each step.
    """

    achieved: np.ndarray
    desired: np.ndarray
    rewards: np.ndarray
    infos: list[dict[str, Any]]


class GoalInfo(gym.Wrapper):
    """Give `info` the entries `is_success` and `is_failure`, and HER the reward to relabel with."""

    def __init__(self, env: gym.Env, config: GymnasiumConfig) -> None:
        super().__init__(env)
        self.config = config
        self.goal_reward = GymnasiumReward(config)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the env."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        key = self.config.success_key or next((key for key in SUCCESS_KEYS if key in info), None)
        is_success = bool(key and info.get(key))
        is_failure = bool(self.config.failure_key and info.get(self.config.failure_key))
        info = {**info, "is_success": is_success, "is_failure": is_failure}
        return observation, float(reward), bool(terminated), bool(truncated), info

    def close(self) -> None:
        """Close the env, and the env of its reward.

        An error of the env's own `close` is ignored, since its work is done.
        """
        with suppress(Exception):
            self.env.close()
        self.goal_reward.close()


class GymnasiumReward(GoalReward):
    """The `compute_reward` of an environment, for many goals at once.

    If episodes end at their goals, `compute_terminated` says whether a goal is reached. Otherwise
    it is reached where the reward is as high as at the goal itself.
    """

    def __init__(self, config: GymnasiumConfig) -> None:
        self.config = config

    @cached_property
    def env(self) -> gym.Env:
        """Env for `compute_reward`; made late, as this object is pickled for other processes."""
        return make_gymnasium_env(self.config)

    def close(self) -> None:
        """Close the environment if it was made."""
        if "env" in vars(self):
            self.env.close()

    @cached_property
    def steps(self) -> RandomSteps:
        """The steps of `random_steps`. The environment is left at the start of an episode."""
        assert isinstance(self.env, GoalInfo)
        steps = random_steps(self.env.env)
        self.env.reset(seed=0)
        return steps

    @cached_property
    def terminates(self) -> bool:
        """Whether episodes end where the goal is reached, as `compute_terminated` says."""
        goal = self.steps.desired[0]
        info = self.steps.infos[0]
        return bool(self._compute_terminated(goal, goal, info))

    @cached_property
    def _compute_terminated(self) -> Callable[..., Any]:
        if self.env.has_wrapper_attr("compute_terminated"):
            return self.env.get_wrapper_attr("compute_terminated")
        return lambda *_: False

    @cached_property
    def info_keys(self) -> tuple[str, ...]:
        """Numeric entries that every info has; none if the reward does not depend on info."""
        achieved, desired, _, infos = self.steps
        try:
            without = self.compute(achieved, desired, [{} for _ in infos])
            needed = not np.array_equal(without, self.compute(achieved, desired, infos))
        except Exception:  # whatever a function raises that misses something
            needed = True
        if not needed:
            return ()

        keys = []
        for key in infos[0]:
            if all(isinstance(info.get(key), NUMBERS) for info in infos):
                keys.append(key)
        return tuple(keys)

    @cached_property
    def _convert_infos(self) -> Callable[[list[dict[str, Any]]], Any]:
        """The function that converts many infos to what `compute_reward` takes.

        That is a list, or an array if it refuses lists. Stable-Baselines3 passes either of them,
        depending on `copy_info_dict`.
        """
        achieved, desired, _, infos = self.steps
        try:
            self.env.get_wrapper_attr("compute_reward")(achieved, desired, infos)
        except Exception:  # whatever a function raises that expects an array
            return partial(np.array, dtype=object)
        return list

    def compute(
        self, achieved: np.ndarray, desired: np.ndarray, infos: list[dict[str, Any]]
    ) -> np.ndarray:
        """Return the rewards that the environment or one of its wrappers computes, shape (n,)."""
        infos = self._convert_infos(infos)
        rewards = self.env.get_wrapper_attr("compute_reward")(achieved, desired, infos)
        return np.reshape(rewards, -1)  # one number for one goal, or a column

    def __call__(
        self, achieved: np.ndarray, desired: np.ndarray, info: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return reward and whether the goal is reached, shape (n,); `info` is (n, info_keys)."""
        rows = np.empty((len(desired), 0)) if info is None else info
        infos = [dict(zip(self.info_keys, row.tolist(), strict=False)) for row in rows]
        reward = self.compute(achieved, desired, infos)
        if not self.terminates:
            return reward, reward >= self.compute(desired, desired, infos)
        # It takes one goal at a time.
        reached = list(map(self._compute_terminated, achieved, desired, infos))
        return reward, np.array(reached, bool)


def random_steps(env: gym.Env) -> RandomSteps:
    """Take the same random steps in every call: RANDOM_STEPS, or more until an episode has ended.

    Some entries of `info` appear only at the end of an episode. After MAX_RANDOM_STEPS, it stops
    even if none has ended.
    """
    env.action_space.seed(0)
    env.reset(seed=0)
    achieved = []
    desired = []
    rewards = []
    infos: list[dict[str, Any]] = []
    has_ended = False
    while len(infos) < RANDOM_STEPS or (not has_ended and len(infos) < MAX_RANDOM_STEPS):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        achieved.append(np.array(observation["achieved_goal"]))
        desired.append(np.array(observation["desired_goal"]))
        rewards.append(float(reward))
        infos.append(info)
        if terminated or truncated:
            has_ended = True
            env.reset()
    return RandomSteps(np.array(achieved), np.array(desired), np.array(rewards), infos)


def make_gymnasium_env(config: GymnasiumConfig, render_mode: str | None = None) -> gym.Env:
    """Make one environment.

    Raises:
        ConfigError: it is not registered, cannot be imported or refuses its arguments.
    """
    for package in ("gymnasium_robotics", "highway_env"):
        is_unknown = ":" not in config.id and config.id not in gym.registry
        if is_unknown and importlib.util.find_spec(package):
            # What it prints is a notice about other environments.
            with redirect_stdout(sys.stderr), redirect_stderr(io.StringIO()):
                gym.register_envs(importlib.import_module(package))
    options = dict(config.kwargs)
    if render_mode is not None:
        options["render_mode"] = render_mode
    try:
        with redirect_stdout(sys.stderr), redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # deprecations inside of other packages
            env = gym.make(
                config.id,
                max_episode_steps=config.max_episode_steps,
                disable_env_checker=True,
                **options,
            )
    except (gym.error.UnregisteredEnv, ModuleNotFoundError) as error:
        raise ConfigError(_not_found(config.id, error)) from error
    except gym.error.DependencyNotInstalled as error:
        raise ConfigError(f"env.id={config.id}: {error}") from error
    except Exception as error:  # whatever a user's module or class raises
        arguments = f", env.kwargs={config.kwargs}" if config.kwargs else ""
        raise ConfigError(f"env.id={config.id}{arguments}: {class_and_message(error)}") from error
    return GoalInfo(env, config)


def _not_found(env_id: str, error: Exception) -> str:
    if isinstance(error, ModuleNotFoundError):
        name = getattr(error.__cause__, "name", None) or error.name
        return (
            f"env.id={env_id} needs the module {name}, which is not installed or not on PYTHONPATH"
        )
    if env_id.startswith(ROBOTICS) and not importlib.util.find_spec("gymnasium_robotics"):
        return (
            f"env.id={env_id} needs gymnasium-robotics, which is not installed; pip install "
            "'parking-exp[robotics]'"
        )
    if ":" in env_id:
        module, name = env_id.split(":")
        return f"env.id={env_id}: {module} registers no {name}{suggestion(name, gym.registry)}"
    return (
        f"env.id={env_id} is not registered with Gymnasium; if another package has it, name the "
        f"module that registers it: env.id=MODULE:{env_id}{suggestion(env_id, gym.registry)}"
    )

"""Check whether a Gymnasium environment can be trained on with HER, by random actions."""

from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from parking_exp.errors import ConfigError, class_and_message
from parking_exp.tasks.gymnasium_config import SUCCESS_KEYS, GymnasiumConfig
from parking_exp.tasks.gymnasium_env import (
    RANDOM_STEPS,
    GymnasiumReward,
    make_gymnasium_env,
    random_steps,
)
from parking_exp.tasks.training_envs import ReplayActions

TOLERANCE = 1e-6  # rewards may be float32
FAR = 1_000.0  # offset of a goal that random steps do not reach
VECTORS = (spaces.Box, spaces.MultiBinary)


def environment_problem(config: GymnasiumConfig) -> str | None:
    """Return what an environment lacks to be a goal task, or None."""
    env_id = f"env.id={config.id}"
    reward = GymnasiumReward(config)
    with closing(reward):
        try:
            env = reward.env
        except ConfigError as error:
            return str(error)
        problem = _space_problem(env, env_id)
        if problem is not None:
            return problem
        try:
            return _info_problem(reward, env_id) or _reward_problem(reward, env_id)
        except Exception as error:  # whatever a user's environment raises
            return f"{env_id}: {class_and_message(error)}"


def _space_problem(env: gym.Env, env_id: str) -> str | None:
    """Return what is wrong with an environment that has not been stepped yet."""
    space = env.observation_space
    actions = env.action_space
    entries = space.spaces if isinstance(space, spaces.Dict) else {}
    for key in ("desired_goal", "achieved_goal", "observation"):
        if key not in entries:
            return f"{env_id} is not a goal environment: its observation has no {key}"
    for key, entry in entries.items():
        if not isinstance(entry, VECTORS) or len(entry.shape) != 1:
            return f"{env_id} has the {key} {entry}; it has to be a vector"
    is_float = isinstance(actions, spaces.Box) and np.issubdtype(actions.dtype, np.floating)
    if not is_float or not actions.is_bounded():
        return (
            f"{env_id} has the actions {actions}; they have to be continuous, a Box of float32 "
            "with finite bounds, and can be rounded in `step`"
        )
    if not env.has_wrapper_attr("compute_reward"):
        return f"{env_id} is not a goal environment: it has no compute_reward"
    if env.spec is None or env.spec.max_episode_steps is None:
        return f"{env_id} has no limit to the length of an episode; set env.max_episode_steps"
    return None


def _info_problem(reward: GymnasiumReward, env_id: str) -> str | None:
    """Return which entry of `info` is missing in random steps."""
    config = reward.config
    known: dict[str, Any] = {}
    for info in reward.steps.infos:
        known |= info
    for name in ("success_key", "failure_key"):
        key = getattr(config, name)
        if key is not None and key not in known:
            return (
                f"env.{name}={key}: there is no such entry of info; there are "
                f"{', '.join(known) or 'none'}"
            )
    if config.success_key is None and not any(key in known for key in SUCCESS_KEYS):
        return (
            f"{env_id}: info has neither {' nor '.join(SUCCESS_KEYS)}; name the entry in "
            "env.success_key"
        )
    return None


def _reward_problem(reward: GymnasiumReward, env_id: str) -> str | None:
    """Return how `compute_reward`, called once for all random steps, differs from their rewards."""
    failure_key = reward.config.failure_key
    achieved, desired, rewards, infos = reward.steps
    try:
        computed = reward.compute(achieved, desired, infos)
    except Exception as error:  # whatever a function that was not written for batches raises
        return f"{env_id}: compute_reward is not vectorized: {class_and_message(error)}"
    if len(computed) != len(rewards):
        return (
            f"{env_id}: compute_reward is not vectorized: for {len(infos)} goals it returns "
            f"{len(computed)} rewards"
        )
    failed = np.array([bool(failure_key and info.get(failure_key)) for info in infos])
    is_equal = np.abs(computed - rewards) <= TOLERANCE
    different = np.flatnonzero(~is_equal & ~failed)
    if len(different):
        step = different[0]
        return (
            f"{env_id}: compute_reward gives {computed[step]:.6g} for a step of reward "
            f"{rewards[step]:.6g}; if that is a penalty for failure, set env.failure_key to the "
            "entry of info that reports it"
        )
    ignored = _ignored_goal(reward, computed)
    if ignored is not None:
        return (
            f"{env_id}: compute_reward ignores its {ignored}: whatever it is, {len(infos)} random "
            "steps have the same rewards; compute them from the arguments, not from a goal or a "
            "state that the environment keeps"
        )
    rows = np.array([[float(info[key]) for key in reward.info_keys] for info in infos])
    # Calls `compute_terminated`, whose error is then reported.
    relabelled, _ = reward(achieved, desired, rows)
    if not np.allclose(relabelled, computed, rtol=0, atol=TOLERANCE):
        return (
            f"{env_id}: compute_reward depends on more than goals and the numbers in every info; "
            "HER can't compute it"
        )
    return None


def _ignored_goal(reward: GymnasiumReward, computed: np.ndarray) -> str | None:
    """Return which goal never changes `computed`, the rewards of random steps, even far away."""
    achieved = reward.steps.achieved
    infos = reward.steps.infos
    far = (achieved + FAR).astype(achieved.dtype)
    try:
        at_goal = reward.compute(achieved, achieved.copy(), infos)
        with_far_goal = reward.compute(achieved, far, infos)
        from_far = reward.compute(far, achieved, infos)
    except Exception:  # an environment that refuses goals out of reach does not ignore them
        return None
    if np.array_equal(at_goal, with_far_goal) and np.array_equal(at_goal, computed):
        return "desired_goal"
    return "achieved_goal" if np.array_equal(at_goal, from_far) else None


def resumes_exactly(config: GymnasiumConfig) -> bool:
    """Return whether an env continues identically after replaying the actions of another."""
    with (
        closing(ReplayActions(make_gymnasium_env(config))) as first,
        closing(ReplayActions(make_gymnasium_env(config))) as second,
    ):
        return _continues_identically(first, second)


def _continues_identically(first: ReplayActions, second: ReplayActions) -> bool:
    random_steps(first)
    first.reset()  # what an episode leaves behind must not affect the next
    for _ in range(3):
        first.step(first.action_space.sample())
    second.set_state(first.get_state())
    for _ in range(RANDOM_STEPS):
        action = first.action_space.sample()
        expected, *expected_end, _ = first.step(action)
        observation, *end, _ = second.step(action)
        is_same = all(np.array_equal(expected[key], observation[key]) for key in expected)
        if not is_same or end != expected_end:
            return False
        _, terminated, truncated = end
        if terminated or truncated:
            first.reset()
            second.reset()
    return True

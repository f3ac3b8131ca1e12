"""Check whether a Gymnasium environment can be trained on with HER, by random actions."""

from collections.abc import Iterator

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from parking_exp.errors import ConfigError, one_line
from parking_exp.tasks.gymnasium_config import GymnasiumConfig
from parking_exp.tasks.gymnasium_env import (
    GOAL_KEYS,
    RANDOM_STEPS,
    SUCCESS_KEYS,
    GymnasiumReward,
    make_env,
    random_steps,
)
from parking_exp.tasks.training_envs import ReplayActions

TOLERANCE = 1e-6  # of rewards, which may be float32


def check_env(config: GymnasiumConfig) -> Iterator[str]:
    """Yield what an environment lacks to be a goal task, at most one sentence."""
    try:
        env = make_env(config)
    except ConfigError as error:
        yield str(error)
        return
    env_id, space, actions = f"env.id={config.id}", env.observation_space, env.action_space
    entries = space.spaces if isinstance(space, spaces.Dict) else {}
    not_vectors = [key for key, entry in entries.items() if len(entry.shape or ()) != 1]
    if absent := [key for key in reversed(GOAL_KEYS) if key not in entries]:
        yield f"{env_id} is not a goal environment: its observation has no {absent[0]}"
    elif not_vectors:
        yield f"{env_id} has the {not_vectors[0]} {entries[not_vectors[0]]}; it has to be a vector"
    elif not isinstance(actions, spaces.Box) or not actions.is_bounded():
        yield f"{env_id} has the actions {actions}; they have to be continuous with finite bounds (Box)"
    elif not hasattr(env.unwrapped, "compute_reward"):
        yield f"{env_id} is not a goal environment: it has no compute_reward"
    elif env.spec is None or env.spec.max_episode_steps is None:
        yield f"{env_id} has no limit to the length of an episode; set env.max_episode_steps"
    else:
        try:
            yield from _check_steps(env, config, env_id)
        except Exception as error:  # whatever a user's environment raises
            yield f"{env_id}: {type(error).__name__}: {one_line(error)}"


def _check_steps(env: gym.Env, config: GymnasiumConfig, env_id: str) -> Iterator[str]:
    """Compare the rewards of random steps with those that `compute_reward` returns for the whole batch."""
    achieved, desired, rewards, infos = random_steps(env.env)
    known = {key: None for info in infos for key in info}
    for name in ("success_key", "failure_key"):
        if (key := getattr(config, name)) is not None and key not in known:
            yield f"env.{name}={key}: there is no such entry of info; there are {', '.join(known) or 'none'}"
            return
    if config.success_key is None and not any(key in known for key in SUCCESS_KEYS):
        yield f"{env_id}: info has neither {' nor '.join(SUCCESS_KEYS)}; name the entry in env.success_key"
        return
    try:
        computed = np.asarray(env.unwrapped.compute_reward(achieved, desired, infos))
    except Exception as error:  # whatever a function that was not written for batches raises
        yield f"{env_id}: compute_reward is not vectorised: {type(error).__name__}: {one_line(error)}"
        return
    if computed.shape != rewards.shape:
        yield f"{env_id}: compute_reward is not vectorised: for {len(infos)} goals it returns shape {computed.shape}"
        return
    failed = np.array([bool(config.failure_key and info.get(config.failure_key)) for info in infos])
    different = np.flatnonzero(~(np.abs(computed - rewards) <= TOLERANCE) & ~failed)
    if len(different):
        step = different[0]
        yield (
            f"{env_id}: compute_reward gives {computed[step]:.6g} for a step of reward {rewards[step]:.6g}; if that is "
            "a penalty for failure, set env.failure_key to the entry of info that reports it"
        )
        return
    reward = GymnasiumReward(config)
    rows = np.array([[float(info[key]) for key in reward.info_keys] for info in infos])
    relabelled, _ = reward(achieved, desired, rows)  # calls `compute_terminated`, whose error is then reported
    if not np.allclose(relabelled, computed, rtol=0, atol=TOLERANCE):
        yield f"{env_id}: compute_reward depends on more than goals and the numbers in every info; HER can't compute it"


def resumes_exactly(config: GymnasiumConfig) -> bool:
    """Return whether an env continues identically after replaying the actions of another."""
    first, second = ReplayActions(make_env(config)), ReplayActions(make_env(config))
    random_steps(first)
    first.reset()  # what an episode leaves behind must not affect the next
    for _ in range(3):
        first.step(first.action_space.sample())
    second.set_state(first.get_state())
    for _ in range(RANDOM_STEPS):
        action = first.action_space.sample()
        (expected, reward, *ended, _), (observation, *others, _) = first.step(action), second.step(action)
        same = all(np.array_equal(expected[key], observation[key]) for key in GOAL_KEYS)
        if not (same and [reward, *ended] == others):
            return False
        if any(ended):
            first.reset()
            second.reset()
    return True

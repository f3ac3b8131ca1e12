"""Check whether a Gymnasium environment can be trained on with HER, by random actions."""

from collections.abc import Iterator

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from parking_exp.errors import ConfigError
from parking_exp.tasks.gymnasium_config import GymnasiumConfig
from parking_exp.tasks.gymnasium_env import GOAL_KEYS, RANDOM_STEPS, SUCCESS_KEYS, make_env, random_steps
from parking_exp.tasks.training_envs import ReplayActions

TOLERANCE = 1e-6  # of rewards, which may be float32


def check_env(config: GymnasiumConfig) -> Iterator[str]:
    """Yield what an environment lacks to be a goal task, at most one sentence."""
    try:
        env = make_env(config)
    except ConfigError as error:
        yield str(error)
        return
    place, space = f"env.id={config.id}", env.observation_space
    known = set(space.spaces) if isinstance(space, spaces.Dict) else set()
    if absent := [key for key in reversed(GOAL_KEYS) if key not in known]:
        yield f"{place} is not a goal environment: its observation has no {absent[0]}"
    elif not isinstance(env.action_space, spaces.Box):
        yield f"{place} has the actions {env.action_space}; SAC, TD3 and DDPG need continuous ones (Box)"
    elif not hasattr(env.unwrapped, "compute_reward"):
        yield f"{place} is not a goal environment: it has no compute_reward"
    elif env.spec is None or env.spec.max_episode_steps is None:
        yield f"{place} has no limit to the length of an episode; set env.max_episode_steps"
    else:
        yield from _check_steps(env, config, place)


def _check_steps(env: gym.Env, config: GymnasiumConfig, place: str) -> Iterator[str]:
    """Compare the rewards of random steps with what `compute_reward` says of all of them at once."""
    achieved, desired, rewards, infos = random_steps(env)
    for name in ("success_key", "failure_key"):
        if (key := getattr(config, name)) is not None and key not in infos[0]:
            yield f"env.{name}={key}: there is no such entry of info; there are {', '.join(infos[0])}"
            return
    if config.success_key is None and not any(key in infos[0] for key in SUCCESS_KEYS):
        yield f"{place}: info has neither {' nor '.join(SUCCESS_KEYS)}; name what says it as env.success_key"
        return
    try:
        computed = np.asarray(env.unwrapped.compute_reward(achieved, desired, infos))
    except Exception as error:  # whatever a function that was not written for batches raises
        yield f"{place}: compute_reward is not vectorised: {type(error).__name__}: {' '.join(str(error).split())}"
        return
    if computed.shape != rewards.shape:
        yield f"{place}: compute_reward is not vectorised: for {len(infos)} goals it returns the shape {computed.shape}"
        return
    failed = np.array([bool(config.failure_key and info[config.failure_key]) for info in infos])
    different = np.flatnonzero((np.abs(computed - rewards) > TOLERANCE) & ~failed)
    if len(different):
        step = different[0]
        yield (
            f"{place}: compute_reward gives {computed[step]:.6g} for a step of reward {rewards[step]:.6g}; if that is "
            "the penalty of a failure, name its entry of info as env.failure_key"
        )


def resumes_exactly(config: GymnasiumConfig) -> bool:
    """Return whether another env goes on as one that it takes the state of, by replaying its actions."""
    first, second = ReplayActions(make_env(config)), ReplayActions(make_env(config))
    random_steps(first)
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

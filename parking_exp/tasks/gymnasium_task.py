"""Any goal environment that is registered with Gymnasium, as a task."""

import os
from collections.abc import Iterator, Sequence
from contextlib import closing
from functools import cached_property
from itertools import compress
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from parking_exp.errors import VideoError
from parking_exp.tasks.captions import LAST_FRAME_S, captioned
from parking_exp.tasks.environment_checks import check_env, resumes_exactly
from parking_exp.tasks.gymnasium_config import GymnasiumConfig
from parking_exp.tasks.gymnasium_env import GOAL_KEYS, make_env
from parking_exp.tasks.metrics import GYMNASIUM_METRICS, outcome
from parking_exp.tasks.task import EvaluationBatch, Observation, Policy, Step
from parking_exp.tasks.training_envs import ReplayActions


class GymnasiumBatch:
    """Episodes of a Gymnasium environment, an env for each, stepped together."""

    def __init__(self, envs: Sequence[gym.Env], seeds: Sequence[int]) -> None:
        self.envs = [*envs[: len(seeds)]]
        self._observations = [env.reset(seed=int(seed))[0] for env, seed in zip(self.envs, seeds, strict=True)]

    def __len__(self) -> int:
        return len(self.envs)

    def observe(self) -> Observation:
        """Return the observations of all episodes."""
        return {key: np.stack([observation[key] for observation in self._observations]) for key in GOAL_KEYS}

    def step(self, actions: np.ndarray) -> Step:
        """Step all episodes; actions have the shape (n, actions)."""
        results = [env.step(action) for env, action in zip(self.envs, actions, strict=True)]
        self._observations = [result[0] for result in results]
        columns = [[result[index] for result in results] for index in (1, 2, 3)]
        columns += [[result[4][key] for result in results] for key in ("is_failure", "is_success")]
        return Step(self.observe(), *(np.array(column) for column in columns))

    def keep(self, rows: np.ndarray) -> None:
        """Keep only some of the episodes, by mask."""
        self.envs = list(compress(self.envs, rows))
        self._observations = list(compress(self._observations, rows))

    def ending(self, row: int) -> None:
        """Return nothing: the metrics of these tasks need no more than the outcome."""

    def positions(self) -> np.ndarray:
        """Return nothing to record, shape (n, 0)."""
        return np.empty((len(self), 0))


class GymnasiumTask:
    """The task of a registered goal environment."""

    metrics = GYMNASIUM_METRICS
    failure = "failure"
    ranking: tuple[str, ...] = ("success", "failure", "steps")
    recorded: tuple[str, ...] = ()
    monitored: tuple[str, ...] = ("is_success",)
    batch_size = 10  # each has an env of its own, which may take a second to make

    def __init__(self, config: GymnasiumConfig) -> None:
        self.config = config
        self.env_id = config.id
        self._envs: list[gym.Env] = []

    @property
    def frame_rate(self) -> int:
        """Frames per second of a video."""
        return int(self.prediction_env().metadata.get("render_fps") or 30)

    def training_envs(self, n_envs: int) -> VecEnv:
        """Make training envs, in this process or in one each."""
        makers = [lambda: ReplayActions(make_env(self.config))] * n_envs
        return SubprocVecEnv(makers) if self.config.vectorization == "async" else DummyVecEnv(makers)

    def evaluation_batch(self, seeds: Sequence[int], simulator: str) -> EvaluationBatch:
        """Start the episodes of some seeds; the envs are used again."""
        self._envs += [make_env(self.config) for _ in range(len(seeds) - len(self._envs))]
        return GymnasiumBatch(self._envs, seeds)

    def prediction_env(self) -> gym.Env:
        """Return an env."""
        if not self._envs:
            self._envs.append(make_env(self.config))
        return self._envs[0]

    @cached_property
    def episode_steps(self) -> int:
        """The longest episode."""
        spec = self.prediction_env().spec
        return (spec and spec.max_episode_steps) or 1

    def problems(self) -> Iterator[str]:
        """Yield a sentence for each thing that the environment lacks to be a goal task."""
        return check_env(self.config)

    def notes(self) -> Iterator[str]:
        """Yield whether an interrupted run resumes exactly."""
        if not resumes_exactly(self.config):
            yield f"{self.config.id} is not deterministic: an interrupted run resumes, but not bit-identically"

    def features(self, name: str) -> None:
        """Return None: all features are raw."""

    def frames(self, policy: Policy, seeds: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield a frame for the start of each episode and each step, and one second of its end."""
        with closing(_rendered(self.config)) as env:
            for seed in seeds:
                observation, info = env.reset(seed=seed)
                done = False
                while not done:
                    yield captioned(_frame(env), f"seed {seed}")
                    action = policy({key: observation[key][np.newaxis] for key in GOAL_KEYS})[0]
                    observation, _, terminated, truncated, info = env.step(action)
                    done = terminated or truncated
                ending = outcome(self.failure, info["is_failure"], info["is_success"])
                last = captioned(_frame(env), f"seed {seed}: {ending}")
                yield from [last] * round(LAST_FRAME_S * self.frame_rate)


def _frame(env: gym.Env) -> np.ndarray:
    frame: Any = env.render()
    return np.asarray(frame)


def _rendered(config: GymnasiumConfig) -> gym.Env:
    """Make an env that renders; MuJoCo without a display by EGL or OSMesa, whichever there is."""
    if "rgb_array" not in make_env(config).metadata.get("render_modes", ()):
        raise VideoError(f"no video: env.id={config.id} does not render to arrays")
    chosen, problems = os.environ.get("MUJOCO_GL"), []
    for backend in [chosen] if chosen else ["egl", "osmesa"]:
        os.environ["MUJOCO_GL"] = backend
        try:
            env = make_env(config, "rgb_array")
            env.reset(seed=0)
            env.render()
        except Exception as error:  # of drivers, bindings and shared libraries
            problems.append(f"MUJOCO_GL={backend}: {type(error).__name__}: {' '.join(str(error).split())}")
        else:
            return env
    if chosen is None:
        del os.environ["MUJOCO_GL"]
    raise VideoError(f"no video of env.id={config.id}: {'; '.join(problems)}")

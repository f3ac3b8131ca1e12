"""Any goal environment that is registered with Gymnasium, as a task."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from functools import cached_property, partial

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from parking_exp.errors import VideoError, one_line
from parking_exp.tasks.captions import LAST_FRAME_S, add_caption
from parking_exp.tasks.env_batch import EnvBatch
from parking_exp.tasks.environment_checks import check_env, resumes_exactly
from parking_exp.tasks.gymnasium_config import GymnasiumConfig
from parking_exp.tasks.gymnasium_env import make_env
from parking_exp.tasks.metrics import GYMNASIUM_METRICS, outcome
from parking_exp.tasks.task import EvaluationBatch, Policy
from parking_exp.tasks.training_envs import ReplayActions


class GymnasiumTask:
    """The task of a registered goal environment."""

    metrics = GYMNASIUM_METRICS
    failure = "failure"
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
        if self.config.vectorization == "async":
            return SubprocVecEnv([partial(_env_of_worker, self.config)] * n_envs)
        return DummyVecEnv([lambda: ReplayActions(make_env(self.config))] * n_envs)

    def evaluation_batch(self, seeds: Sequence[int], simulator: str) -> EvaluationBatch:
        """Start the episodes of some seeds; envs are reused."""
        self._envs += [make_env(self.config) for _ in range(len(seeds) - len(self._envs))]
        return EnvBatch(self._envs[: len(seeds)], seeds, "is_failure")

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
        """Return None, as there are raw features only."""

    def frames(self, policy: Policy, seeds: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield a frame for the start of each episode and each step, and one second of its end."""
        if "rgb_array" not in self.prediction_env().metadata.get("render_modes", ()):
            raise VideoError(f"no video: env.id={self.env_id} does not render to arrays")
        with closing(_make_video_env(self.config)) as env:
            for seed in seeds:
                observation, info = env.reset(seed=seed)
                done = False
                while not done:
                    yield add_caption(np.asarray(env.render()), f"seed {seed}")
                    action = policy({key: value[np.newaxis] for key, value in observation.items()})[0]
                    observation, _, terminated, truncated, info = env.step(action)
                    done = terminated or truncated
                ending = outcome(self.failure, info["is_failure"], info["is_success"])
                last = add_caption(np.asarray(env.render()), f"seed {seed}: {ending}")
                yield from [last] * round(LAST_FRAME_S * self.frame_rate)


def _env_of_worker(config: GymnasiumConfig) -> gym.Env:
    """Make an env in a process of its own, which leaves signals to the training: it ends with the pipe."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    return ReplayActions(make_env(config))


def _make_video_env(config: GymnasiumConfig) -> gym.Env:
    """Make an env that renders; VideoError where none can."""
    if "mujoco" in sys.modules and "MUJOCO_GL" not in os.environ:
        os.environ["MUJOCO_GL"] = _mujoco_backend()
    try:
        env = make_env(config, "rgb_array")
        env.reset(seed=0)
        env.render()
    except Exception as error:  # of drivers, bindings and shared libraries
        raise VideoError(f"no video of env.id={config.id}: {type(error).__name__}: {one_line(error)}") from error
    return env


def _mujoco_backend() -> str:
    """Return how MuJoCo renders without a display on this machine; VideoError where neither EGL nor OSMesa works.

    Each is tried in a process of its own: a failed attempt leaves settings that break the next.
    """
    program = [sys.executable, "-c", "import mujoco; mujoco.GLContext(8, 8).make_current()"]
    for backend in ("egl", "osmesa"):
        environment = {**os.environ, "MUJOCO_GL": backend}
        if subprocess.run(program, env=environment, capture_output=True, check=False).returncode == 0:
            return backend
    raise VideoError("no video: MuJoCo renders by EGL or OSMesa, and neither works here; install e.g. libosmesa6")

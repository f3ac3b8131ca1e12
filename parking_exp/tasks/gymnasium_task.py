"""Any goal environment that is registered with Gymnasium, as a task."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cached_property, partial

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from parking_exp.errors import EnvProcessError, VideoError
from parking_exp.tasks.env_batch import EnvBatch
from parking_exp.tasks.environment_checks import environment_problem, resumes_exactly
from parking_exp.tasks.episode_frames import episode_frames
from parking_exp.tasks.gymnasium_config import GymnasiumConfig
from parking_exp.tasks.gymnasium_env import make_gymnasium_env
from parking_exp.tasks.rollout import rollout
from parking_exp.tasks.task import EvaluationBatch, Policy, Task
from parking_exp.tasks.training_envs import ReplayActions
from parking_exp.terminal import make_output_unfailing


class GymnasiumTask(Task):
    """The task of a registered goal environment."""

    batch_size = 4  # each has an env of its own, which may take a second to make, and much memory

    def __init__(self, config: GymnasiumConfig) -> None:
        self.config = config
        self._envs: list[gym.Env] = []

    @property
    def env_id(self) -> str:
        """Id of the environment."""
        return self.config.id

    @property
    def frame_rate(self) -> int:
        """Frames per second of a video."""
        return int(self._any_env().metadata.get("render_fps") or super().frame_rate)

    def training_envs(self, n_envs: int) -> VecEnv:
        """Make training envs, in this process or in one each."""
        if self.config.vectorization == "async":
            spec = gym.registry.get(self.config.id)
            return EnvProcesses([partial(_env_of_worker, self.config, spec)] * n_envs)
        return DummyVecEnv([lambda: ReplayActions(make_gymnasium_env(self.config))] * n_envs)

    def evaluation_batch(self, seeds: Sequence[int], simulator: str | None) -> EvaluationBatch:
        """Start the episodes of some seeds; envs are reused."""
        self._envs += [make_gymnasium_env(self.config) for _ in range(len(seeds) - len(self._envs))]
        return EnvBatch(self._envs[: len(seeds)], seeds, "is_failure")

    def close(self) -> None:
        """Close the envs of evaluations."""
        for env in self._envs:
            env.close()
        self._envs.clear()
        self._prediction_env = None  # its env was one of these

    def _make_prediction_env(self) -> VecEnv:
        return DummyVecEnv([self._any_env])

    def _any_env(self) -> gym.Env:
        if not self._envs:
            self._envs.append(make_gymnasium_env(self.config))
        return self._envs[0]

    @cached_property
    def episode_steps(self) -> int:
        """The longest episode."""
        with closing(make_gymnasium_env(self.config)) as env:
            return (env.spec and env.spec.max_episode_steps) or 1

    def problems(self) -> Iterator[str]:
        """Yield what the environment lacks to be a goal task, at most one sentence."""
        problem = environment_problem(self.config)
        if problem is not None:
            yield problem

    def notes(self) -> Iterator[str]:
        """Yield whether an interrupted run resumes exactly."""
        if not resumes_exactly(self.config):
            yield (
                f"{self.config.id} is not deterministic: an interrupted run resumes, but not "
                "bit-identically"
            )

    def frames(self, policy: Policy, seeds: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield a frame for the start of each episode and each step, and one second of its end."""
        if "rgb_array" not in self._any_env().metadata.get("render_modes", ()):
            raise VideoError(f"no video: env.id={self.env_id} does not render to arrays")
        if "mujoco" in sys.modules and "MUJOCO_GL" not in os.environ:
            os.environ["MUJOCO_GL"] = _mujoco_backend()
        with closing(make_gymnasium_env(self.config, "rgb_array")) as env:
            for seed in seeds:
                batch = EnvBatch([env], [seed], "is_failure")
                steps = rollout(policy, batch, [seed])
                draw = partial(_draw, env)
                yield from episode_frames(
                    steps, draw, f"seed {seed}", self.failure, self.frame_rate
                )


class EnvProcesses(SubprocVecEnv):
    """Envs with a process each. If one of them ends, an `EnvProcessError` says so."""

    def __init__(self, env_fns: list[Callable[[], gym.Env]]) -> None:
        with _process_errors():
            super().__init__(env_fns)

    def step_wait(self) -> VecEnvStepReturn:
        """Return what the envs send."""
        with _process_errors():
            return super().step_wait()

    def close(self) -> None:
        """End all processes, even if one of them has ended before."""
        try:
            super().close()
        except (EOFError, ConnectionError):
            for process in self.processes:
                process.kill()


@contextmanager
def _process_errors() -> Iterator[None]:
    try:
        yield
    except (EOFError, ConnectionError) as error:
        raise EnvProcessError(
            "the process of an env has ended, its own error is printed above; "
            "env.vectorization=sync needs no processes"
        ) from error


def _env_of_worker(config: GymnasiumConfig, spec: EnvSpec | None) -> gym.Env:
    """Make an env in a worker process, which ignores signals and ends with its pipe.

    A worker knows only environments that a module registers. `spec` adds the environment that a
    notebook has registered.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    make_output_unfailing()
    if spec is not None:
        gym.registry.setdefault(spec.id, spec)
    return ReplayActions(make_gymnasium_env(config))


def _draw(env: gym.Env) -> list[np.ndarray]:
    """Return one frame."""
    frame = env.render()
    if not isinstance(frame, np.ndarray):
        raise VideoError(
            f"no video: the environment renders {type(frame).__name__} instead of an array"
        )
    return [frame]


def _mujoco_backend() -> str:
    """Return the backend with which MuJoCo renders on this machine without a display.

    Each backend is tried in its own process: a failed attempt leaves settings that break the next.

    Raises:
        VideoError: neither EGL nor OSMesa works.
    """
    program = [sys.executable, "-c", "import mujoco; mujoco.GLContext(8, 8).make_current()"]
    for backend in ("egl", "osmesa"):
        environment = {**os.environ, "MUJOCO_GL": backend}
        attempt = subprocess.run(program, env=environment, capture_output=True, check=False)
        if attempt.returncode == 0:
            return backend
    raise VideoError(
        "no video: MuJoCo renders by EGL or OSMesa, and neither works here; install e.g. libosmesa6"
    )

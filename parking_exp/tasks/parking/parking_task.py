"""Parking as a task: in highway-env itself, and in a vectorized simulator with equal episodes."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from parking_exp.tasks.parking.driven_path import DrivenBatch
from parking_exp.tasks.parking.highway import HighwayBatch, make_parking_env
from parking_exp.tasks.parking.highway_video import frames
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_config import ENV_ID, ParkingConfig
from parking_exp.tasks.parking.parking_metrics import METRICS, PATH_COLUMNS
from parking_exp.tasks.parking.simulator import Simulator
from parking_exp.tasks.parking.simulator.scene_state import SCALES
from parking_exp.tasks.rollout import seed_batches
from parking_exp.tasks.task import EvaluationBatch, Observation, Policy, Task

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv


class ParkingTask(Task):
    """The parking task of an `env` group."""

    metrics = METRICS
    failure = "crash"
    env_id = ENV_ID
    monitored: tuple[str, ...] = ("is_success", "crashed")

    def __init__(self, config: ParkingConfig) -> None:
        self.config = config
        self._envs: list[gym.Env] = []  # the latest batch on highway-env

    @property
    def frame_rate(self) -> int:
        """Frames per second: one for each frame of the simulation."""
        return self.config.simulation_frequency

    def training_envs(self, n_envs: int) -> "VecEnv":
        """Make training envs."""
        # These import torch, which checking a config does not need.
        from stable_baselines3.common.vec_env import DummyVecEnv

        from parking_exp.tasks.parking.vec_env import ParkingVecEnv
        from parking_exp.tasks.training_envs import ReplayActions

        config = self.config.for_training()
        if config.simulator == "vectorized":
            return ParkingVecEnv(config, n_envs)
        return DummyVecEnv([lambda: ReplayActions(make_parking_env(config))] * n_envs)

    def evaluation_batch(self, seeds: Sequence[int], simulator: str | None) -> EvaluationBatch:
        """Start the scenes of some seeds: those of `env.reset(seed=s)` of highway-env."""
        if (simulator or self.config.simulator) == "highway_env":
            self._close_batch()
            batch = HighwayBatch(self.config, seeds)
            self._envs = batch.envs
            return DrivenBatch(batch, self.config)
        scenes = lot_of(self.config).from_seeds(seeds)
        return DrivenBatch(Simulator(self.config, scenes), self.config)

    def close(self) -> None:
        """Close the envs of evaluations on highway-env, and the env of predictions."""
        super().close()
        self._close_batch()

    def _close_batch(self) -> None:
        for env in self._envs:
            env.close()
        self._envs = []

    def _make_prediction_env(self) -> "VecEnv":
        from stable_baselines3.common.vec_env import DummyVecEnv

        return DummyVecEnv([lambda: make_parking_env(self.config)])

    @property
    def episode_steps(self) -> int:
        """The longest training episode, in steps."""
        return self.config.for_training().episode_steps

    def features(self, name: str) -> tuple[type, dict[str, Any]] | None:
        """Return the class of a named features extractor and its arguments; None for `raw`."""
        from parking_exp.tasks.parking.features import EXTRACTORS

        if name not in EXTRACTORS:
            return None
        lot = lot_of(self.config)
        arguments: dict[str, Any] = {
            "lot_size_m": lot.size_m,
            "rays": self.config.observation.rays,
        }
        if name != "ego":
            arguments["reward_weights"] = list(self.config.reward_weights)
            arguments["turned"] = lot.is_turn_symmetric
        if name == "ego_mirrored":
            arguments["handed"] = lot.handed
        return EXTRACTORS[name], arguments

    def positions(self, observation: Observation) -> dict[str, np.ndarray]:
        """Return the poses of the cars [m, rad]."""
        x, y, _, _, cos, sin = (observation["achieved_goal"] * SCALES).T
        return dict(zip(PATH_COLUMNS, (x, y, np.arctan2(sin, cos)), strict=True))

    def frames(self, policy: Policy, seeds: Sequence[int]) -> Iterator[np.ndarray]:
        """Yield the frames of a video of some scenes: a second of it is a second of driving."""
        return frames(policy, self.config, seeds)

    def replay_page(self, policy: Policy, seeds: Sequence[int], title: str) -> str:
        """Return a page that plays some scenes, as the vectorized simulator drives them."""
        from parking_exp.tasks.parking.episode_recording import record_episodes
        from parking_exp.tasks.parking.replay_page import render_replay

        episodes = []
        for batch_seeds in seed_batches(seeds, self, policy):
            episodes += record_episodes(policy, self.config, batch_seeds)
        return render_replay(episodes, self.config.policy_frequency, title)

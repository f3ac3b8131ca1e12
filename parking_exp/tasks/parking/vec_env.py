"""The simulator as a Stable-Baselines3 VecEnv."""

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from parking_exp.tasks.batch_vec_env import BatchVecEnv
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.scenes import Scenes
from parking_exp.tasks.parking.simulator import Simulator


class ParkingVecEnv(BatchVecEnv):
    """VecEnv of n parking envs; the scenes of seeds are highway-env's."""

    batch: Simulator

    def __init__(self, config: ParkingConfig, n_envs: int) -> None:
        self.lot = lot_of(config)
        simulator = Simulator(config, self.sample(np.random.default_rng(), n_envs))
        boxes = {}
        for key, values in simulator.observe().items():
            boxes[key] = spaces.Box(-np.inf, np.inf, values.shape[1:], np.float64)
        observation_space = spaces.Dict(boxes)
        action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        super().__init__(simulator, simulator.reward, n_envs, observation_space, action_space)

    def step_wait(self) -> VecEnvStepReturn:
        """Step all envs; infos have what the reward depends on."""
        keys = self.goal_reward.info_keys
        if not keys:
            return super().step_wait()
        slot_size = self.batch.state.slot_size.tolist()
        observations, rewards, dones, infos = super().step_wait()
        for info, size in zip(infos, slot_size, strict=True):
            info.update(zip(keys, size, strict=True))
        return observations, rewards, dones, infos

    def from_seeds(self, seeds: list[int]) -> Scenes:
        """Return the scenes of some seeds."""
        return self.lot.from_seeds(seeds)

    def sample(self, rng: np.random.Generator, number: int) -> Scenes:
        """Return random scenes, of the same distribution."""
        return self.lot.random(rng, number)

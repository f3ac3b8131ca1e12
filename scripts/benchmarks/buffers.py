"""Benchmark the HER buffer: sampling time, bytes in memory and on disk."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.save_util import save_to_pkl

from benchmarks.timing import Side, interleave, rounded
from parking_exp.buffers import HerBuffer
from parking_exp.config.schema import RunConfig
from parking_exp.envs.reward import GoalReward
from parking_exp.envs.vec_env import ParkingVecEnv

BATCH, N_ENVS = 256, 16
PEER = "stable-baselines3"


class Buffers:
    """Buffers filled with the same random transitions, shared by all figures.

    Args:
        config: config of a run; its env is used.
        capacity: capacity of the large buffers, in transitions.
        samples: number of samples per measurement; the peer draws a twentieth.
    """

    def __init__(self, config: RunConfig, capacity: int, samples: int) -> None:
        self._config, self._capacity, self._samples = config, capacity, samples
        self._kept: dict[str, HerReplayBuffer] = {}
        self._recorded = _record(config, steps=1000)

    def capacity_ratio(self, rounds: int) -> dict[str, Any]:
        """Compare the sampling time of a half-filled buffer with that of a buffer of a hundredth of the size."""
        large, small = self._half(self._capacity), self._half(self._capacity // 100)
        side_large, side_small = self._side(large, self._samples), self._side(small, self._samples)
        return interleave(side_small, side_large, rounds) | {"peer": "a hundredth of it", "unit": "samples"}

    def against_sb3(self, rounds: int) -> dict[str, Any]:
        """Compare samples per second of full buffers with Stable-Baselines3."""
        ours, theirs = (self._filled(cls, self._capacity, self._capacity) for cls in (HerBuffer, HerReplayBuffer))
        side, peer = self._side(ours, self._samples), self._side(theirs, max(1, self._samples // 20))
        return interleave(side, peer, rounds) | {"peer": PEER, "unit": "samples"}

    def memory(self) -> dict[str, Any]:
        """Return the memory of a full buffer in bytes per transition."""
        buffer = self._filled(HerBuffer, self._capacity, self._capacity)
        assert isinstance(buffer, HerBuffer)
        return _exactly(sum(array.nbytes for array in buffer.get_state().values()) / self._capacity)

    def file(self) -> dict[str, Any]:
        """Return the size of a half-filled buffer saved by Stable-Baselines3, in bytes per transition."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "buffer.pkl"
            save_to_pkl(path, self._half(self._capacity))
            return _exactly(path.stat().st_size / (self._capacity // 2))

    def _half(self, capacity: int) -> HerReplayBuffer:
        return self._filled(HerBuffer, capacity, capacity // 2)

    def _side(self, buffer: HerReplayBuffer, samples: int) -> Side:
        def side() -> float:
            for _ in range(samples):
                buffer.sample(BATCH)
            return samples

        return side

    def _filled(self, cls: type[HerReplayBuffer], capacity: int, transitions: int) -> HerReplayBuffer:
        name = f"{cls.__name__} {capacity} {transitions}"
        if name not in self._kept:
            env = ParkingVecEnv(self._config.env, N_ENVS)
            # Both relabel as Stable-Baselines3 does; ours computes rewards without the env.
            options: dict[str, Any] = (
                {"reward": GoalReward.of(self._config.env.for_training())} if cls is HerBuffer else {}
            )
            buffer = cls(capacity, env.observation_space, env.action_space, env, "cpu", N_ENVS, **options)
            for step in range(transitions // N_ENVS):
                buffer.add(*self._recorded[step % len(self._recorded)])
            self._kept[name] = buffer
        return self._kept[name]


def _record(config: RunConfig, steps: int) -> list[tuple[Any, ...]]:
    """Record random transitions; the last ones end all episodes, so that the record can be added repeatedly."""
    rng = np.random.default_rng(0)
    env = ParkingVecEnv(config.env.for_training(), N_ENVS)
    env.seed(0)
    obs = env.reset()
    recorded: list[tuple[Any, ...]] = []
    for step in range(steps):
        actions = rng.uniform(-1, 1, (N_ENVS, *env.action_space.shape)).astype(np.float32)
        next_obs, rewards, dones, infos = env.step(actions)
        assert isinstance(obs, dict)
        assert isinstance(next_obs, dict)
        stored = {key: value.copy() for key, value in next_obs.items()}
        for row in np.flatnonzero(dones):
            for key, value in stored.items():
                value[row] = infos[row]["terminal_observation"][key]
        last = np.full(N_ENVS, step == steps - 1)
        recorded.append((obs, stored, actions, rewards, dones | last, infos))
        obs = {key: value.copy() for key, value in next_obs.items()}
    return recorded


def _exactly(value: float) -> dict[str, Any]:
    return {"bytes": rounded(value), "lowest": rounded(value), "highest": rounded(value), "rounds": 1}

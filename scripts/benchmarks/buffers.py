"""Benchmark the HER buffer: sampling time, bytes in memory."""

from functools import cache
from typing import Any

import numpy as np
from stable_baselines3 import HerReplayBuffer

from benchmarks.timing import Side, interleave, rounded
from parking_exp import compose
from parking_exp.buffers import HerBuffer
from parking_exp.tasks.parking.reward import ParkingReward
from parking_exp.tasks.parking.vec_env import ParkingVecEnv

BATCH, N_ENVS = 256, 16


def capacity_ratio(capacity: int, samples: int, rounds: int) -> dict[str, Any]:
    """Compare the sampling times of a half-filled buffer and of one a hundredth of its size."""
    large, small = (_filled(HerBuffer, size, size // 2) for size in (capacity, capacity // 100))
    entry = interleave(_sampling(small, samples), _sampling(large, samples), rounds)
    return entry | {"peer": "a hundredth of it", "unit": "samples"}


def against_sb3(capacity: int, samples: int, rounds: int) -> dict[str, Any]:
    """Compare samples per second of full buffers with Stable-Baselines3; it draws a twentieth."""
    ours, theirs = (_filled(cls, capacity, capacity) for cls in (HerBuffer, HerReplayBuffer))
    entry = interleave(_sampling(ours, samples), _sampling(theirs, max(1, samples // 20)), rounds)
    return entry | {"peer": "stable-baselines3", "unit": "samples"}


def memory(capacity: int) -> dict[str, Any]:
    """Return the memory of a full buffer in bytes per transition."""
    buffer = _filled(HerBuffer, capacity, capacity)
    value = rounded(sum(array.nbytes for array in buffer.get_state().values()) / capacity)
    return {"value": value, "lowest": value, "highest": value, "rounds": 1}


def _sampling(buffer: HerBuffer | HerReplayBuffer, samples: int) -> Side:
    def sample() -> float:
        for _ in range(samples):
            buffer.sample(BATCH)
        return samples

    return sample


@cache
def _filled(cls: Any, capacity: int, transitions: int) -> Any:
    """Return a buffer of random transitions; both classes relabel as Stable-Baselines3 does."""
    config: Any = compose().env
    env = ParkingVecEnv(config, N_ENVS)
    options: dict[str, Any] = {"env": env}
    if cls is HerBuffer:
        options = {"reward": ParkingReward(config.for_training())}
    buffer = cls(
        capacity, env.observation_space, env.action_space, device="cpu", n_envs=N_ENVS, **options
    )
    recorded = _recorded()
    for step in range(transitions // N_ENVS):
        buffer.add(*recorded[step % len(recorded)])
    return buffer


@cache
def _recorded(steps: int = 1000) -> list[tuple[Any, ...]]:
    """Record random transitions that can be added repeatedly: the last ones end all episodes."""
    rng = np.random.default_rng(0)
    config: Any = compose().env
    env = ParkingVecEnv(config.for_training(), N_ENVS)
    env.seed(0)
    obs: Any = env.reset()
    recorded: list[tuple[Any, ...]] = []
    for step in range(steps):
        actions = rng.uniform(-1, 1, (N_ENVS, *env.action_space.shape)).astype(np.float32)
        next_obs: Any
        next_obs, rewards, dones, infos = env.step(actions)
        stored = {key: value.copy() for key, value in next_obs.items()}
        for row in np.flatnonzero(dones):
            for key, value in stored.items():
                value[row] = infos[row]["terminal_observation"][key]
        last = np.full(N_ENVS, step == steps - 1)
        recorded.append((obs, stored, actions, rewards, dones | last, infos))
        obs = {key: value.copy() for key, value in next_obs.items()}
    return recorded

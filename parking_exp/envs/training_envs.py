"""Training envs as a monitored Stable-Baselines3 VecEnv; their state, for exact resume."""

import time
from pathlib import Path
from typing import Any

from stable_baselines3.common.monitor import ResultsWriter
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecMonitor

from parking_exp.config.schema import ENV_ID, EnvConfig
from parking_exp.envs.action_replay import ReplayActions
from parking_exp.envs.highway import make_env
from parking_exp.envs.vec_env import ParkingVecEnv

MONITORED = ("is_success", "crashed")
MONITOR_STATE = ("episode_returns", "episode_lengths", "episode_count")


def make_training_envs(
    config: EnvConfig, n_envs: int, monitor: Path | None = None, elapsed_s: float = 0.0
) -> VecMonitor:
    """Make the training envs of an `env` group, with what it has for training.

    Args:
        monitor: file of finished training episodes (Stable-Baselines3's Monitor CSV). Rows are appended.
        elapsed_s: time that the run has taken before, so that the file's clock continues.
    """
    simulated: VecEnv
    config = config.for_training()
    if config.simulator == "vectorized":
        simulated = ParkingVecEnv(config, n_envs)
    else:
        simulated = DummyVecEnv([lambda: ReplayActions(make_env(config))] * n_envs)
    envs = VecMonitor(simulated, info_keywords=MONITORED)
    envs.t_start = time.time() - elapsed_s
    if monitor is not None:
        header: dict[str, float | str] = {"t_start": envs.t_start, "env_id": ENV_ID}
        envs.results_writer = ResultsWriter(str(monitor), header, MONITORED, override_existing=not monitor.exists())
    return envs


def get_state(envs: VecEnv) -> dict[str, Any]:
    """Return everything that the future of training envs depends on: nested dicts and lists of arrays and numbers."""
    assert isinstance(envs, VecMonitor)
    simulated = envs.venv
    monitor = {name: getattr(envs, name) for name in MONITOR_STATE}
    if isinstance(simulated, ParkingVecEnv):
        return {"monitor": monitor, "envs": simulated.get_state()}
    return {"monitor": monitor, "envs": simulated.env_method("get_state")}


def set_state(envs: VecEnv, state: dict[str, Any]) -> None:
    """Bring training envs of the same config to a saved state; what follows is identical."""
    assert isinstance(envs, VecMonitor)
    simulated = envs.venv
    for name in MONITOR_STATE:
        setattr(envs, name, state["monitor"][name])
    if isinstance(simulated, ParkingVecEnv):
        simulated.set_state(state["envs"])
        return
    simulated._reset_seeds()  # the seeds of a first reset, which was before the state was saved
    for index, env_state in enumerate(state["envs"]):
        simulated.env_method("set_state", env_state, indices=[index])

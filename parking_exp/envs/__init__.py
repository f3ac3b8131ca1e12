"""Parking environments: parking-v0 and its variants, as highway-env simulates them and as we do."""

from collections.abc import Sequence

from parking_exp.config import EnvConfig, Simulation
from parking_exp.envs.batch import Batch, Step
from parking_exp.envs.highway import HighwayBatch, SparseReward, make_env
from parking_exp.envs.simulator import Simulator
from parking_exp.scenes import Scenes

__all__ = ["Batch", "HighwayBatch", "Scenes", "Simulator", "SparseReward", "Step", "make_env", "start"]


def start(config: EnvConfig, scenes: Sequence[int], simulator: Simulation | None = None) -> Batch:
    """Start scenes together; scene s is what `env.reset(seed=s)` of highway-env makes.

    Args:
        config: the `env` group; episodes last its `duration`.
        scenes: seeds of `env.reset`.
        simulator: what simulates them; None: the config's own.
    """
    if (simulator or config.simulator) == "highway_env":
        return HighwayBatch(config, scenes)
    return Simulator(config, Scenes.from_seeds(scenes, config.vehicles_count))

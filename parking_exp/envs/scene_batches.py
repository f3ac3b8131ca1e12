"""Scenes for evaluation, started together in highway-env or in the simulator."""

from collections.abc import Sequence

from parking_exp.config.schema import EnvConfig, Simulation
from parking_exp.envs.highway import HighwayBatch
from parking_exp.envs.scenes import Scenes
from parking_exp.envs.simulator import Simulator

SceneBatch = HighwayBatch | Simulator
"""n scenes that are stepped together, and never reset by themselves."""


def start_scenes(config: EnvConfig, scenes: Sequence[int], simulator: Simulation | None = None) -> SceneBatch:
    """Start scenes together; scene s is what `env.reset(seed=s)` of highway-env makes.

    Args:
        config: the `env` group; episodes last its `duration`.
        scenes: seeds of `env.reset`.
        simulator: what simulates them; None: the config's own.
    """
    if (simulator or config.simulator) == "highway_env":
        return HighwayBatch(config, scenes)
    return Simulator(config, Scenes.from_seeds(scenes, config.vehicles_count))

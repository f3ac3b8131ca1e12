"""Parking lots as environments of Gymnasium. Importing this module registers them.

For example:

    import gymnasium as gym
    import parking_exp.envs

    env = gym.make("parking_exp/Parallel-v0", level="hard", render_mode="rgb_array")
"""

from collections.abc import Sequence

import gymnasium as gym

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.tasks.parking.parking_config import ParkingConfig

LOTS = {
    "parking_exp/Parallel-v0": "parking_parallel",
    "parking_exp/Bays-v0": "parking_bays",
    "parking_exp/Angled-v0": "parking_angled",
    "parking_exp/DeadEnd-v0": "parking_dead_end",
    "parking_exp/Lots-v0": "parking_lots",
}
"""Ids of the environments, and the options of the config group `env` that describe them."""


def make_lot_env(
    env: str,
    level: str | None = None,
    render_mode: str | None = None,
    overrides: Sequence[str] = (),
) -> gym.Env:
    """Make the environment of an option of the `env` group, simulated by highway-env.

    Args:
        env: such as `parking_parallel`.
        level: one of the option's levels, by default the easy one.
        render_mode: None or `rgb_array`.
        overrides: of the config, as in commands, for example `["env.lot.aisle_width_m=6"]`.

    Raises:
        ConfigError: there is no such option, level or key, or there can't be such a lot.
    """
    from parking_exp.tasks.parking.highway import make_parking_env

    level_override = [] if level is None else [f"env.level={level}"]
    config = compose(f"env={env}", *level_override, *overrides).env
    if not isinstance(config, ParkingConfig) or not config.lot_configs:
        raise ConfigError(f"env={config.name}: it has no lot of its own")
    return make_parking_env(config, render_mode=render_mode)


for _id, _env in LOTS.items():
    gym.register(_id, entry_point="parking_exp.envs:make_lot_env", kwargs={"env": _env})

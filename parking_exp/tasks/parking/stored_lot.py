"""The lot of a stored run, made again from its config."""

from collections.abc import Mapping
from typing import Any

import pandas as pd
import yaml
from omegaconf import OmegaConf

from parking_exp.tasks.parking.highway_lot import HighwayLot
from parking_exp.tasks.parking.lot import Lot, make_lot
from parking_exp.tasks.parking.lot_config import LotConfig, bounds


def stored_lot(config: Mapping[str, Any]) -> Lot:
    """Return the lot of a config by dotted keys, as results have it, or its lots in one."""
    nested = OmegaConf.create({"env": {"vehicles_count": 0}})
    for key, value in config.items():
        if key.startswith(("env.lot.", "env.lots.", "env.vehicles_count")) and not pd.isna(value):
            OmegaConf.update(nested, key, _parsed(value), force_add=True)
    env: Any = OmegaConf.to_container(nested.env)
    if "lots" in env:
        sections = list(env["lots"].values())
    elif "lot" in env:
        sections = [env["lot"]]
    else:
        return HighwayLot(bounds(env["vehicles_count"]), n_obstacles=0)
    lots = [LotConfig.model_validate(section) for section in sections]
    return make_lot(lots, env["vehicles_count"])


def _parsed(value: Any) -> Any:
    """Return a value of a frame, where lists are text, and whole numbers may be floats."""
    parsed = yaml.safe_load(str(value))
    if isinstance(parsed, float) and parsed.is_integer():
        return int(parsed)
    return parsed

"""The lot of a stored run, made again from its config."""

from collections.abc import Mapping
from typing import Any

import pandas as pd
import yaml

from parking_exp.tasks.parking.lot import HighwayLot, Lot, ParametricLot
from parking_exp.tasks.parking.lot_config import LotConfig, bounds

PREFIX = "env.lot."


def stored_lot(config: Mapping[str, Any]) -> Lot:
    """Return the lot of a config by dotted keys, as frames of results have it."""
    vehicles = yaml.safe_load(str(config.get("env.vehicles_count", 0)))
    low, high = bounds(vehicles)
    vehicles_range = (int(low), int(high))
    values: dict[str, Any] = {}
    for key, value in config.items():
        if not key.startswith(PREFIX) or pd.isna(value):
            continue
        *sections, name = key.removeprefix(PREFIX).split(".")
        section = values
        for part in sections:
            section = section.setdefault(part, {})
        section[name] = yaml.safe_load(str(value))
    if not values:
        return HighwayLot(vehicles_range, n_obstacles=0)
    # Frames turn whole numbers into floats where some cells have none.
    return ParametricLot(LotConfig.model_validate(values, strict=False), vehicles_range)

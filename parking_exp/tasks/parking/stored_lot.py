"""The lot of a stored run, made again from its config."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import pandas as pd
from omegaconf import OmegaConf

from parking_exp.tasks.parking.lot import Lot, combine_lots
from parking_exp.tasks.parking.lot_config import LotConfig


def stored_lot(config: Mapping[str, Any]) -> Lot:
    """Return the lot of a stored config by dotted keys; several lots are combined into one."""
    settings = []
    for key, value in config.items():
        if key.startswith(("env.lot.", "env.lots.", "env.vehicles_count")) and not pd.isna(value):
            # In a frame, lists are text, and whole numbers may be floats.
            text = str(value).removesuffix(".0")
            settings.append(f"{key}={text}")
    return _combine_stored(tuple(settings))


@cache
def _combine_stored(settings: tuple[str, ...]) -> Lot:
    """Return the lot of some settings; cells with equal settings share the lot and its scenes."""
    stored: Any = OmegaConf.to_container(OmegaConf.from_dotlist(list(settings)))
    env = stored.get("env", {})
    sections = list(env.get("lots", {}).values())
    if "lot" in env:
        sections = [env["lot"]]
    lots = [LotConfig.model_validate(section) for section in sections]
    return combine_lots(lots, env.get("vehicles_count", 0))

"""Data of the map of the lot: outcomes by goal slot."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd

from parking_exp.tasks.parking.geometry import N_SLOTS
from parking_exp.tasks.parking.scenes import Scenes

OUTCOMES = ("success", "crash", "timeout")


@dataclass(frozen=True)
class SlotRate:
    """Rates of the `n` episodes of all seeds whose goal is one slot, 0 ... 27."""

    slot: int
    n: int
    success: float | None
    crash: float | None
    timeout: float | None


def slot_rates(runs: Sequence[pd.DataFrame]) -> list[SlotRate]:
    """Return the rates of outcomes by goal slot, over the final episodes (scene, outcome) of several runs."""
    if not runs:
        return []
    episodes = pd.concat(runs)
    slots = np.array([_goal(scene) for scene in episodes["scene"].tolist()])
    counts = np.zeros((N_SLOTS, len(OUTCOMES)), int)
    np.add.at(counts, (slots, pd.Categorical(episodes["outcome"].astype(object), OUTCOMES).codes), 1)
    return [SlotRate(slot, int(row.sum()), *(row / row.sum()).tolist()) for slot, row in enumerate(counts) if row.any()]


@cache
def _goal(scene: int) -> int:
    return int(Scenes.from_seeds([scene]).goal[0])

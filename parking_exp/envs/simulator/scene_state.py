"""State of many scenes as arrays."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from parking_exp.envs.geometry import SLOT_HEADINGS, SLOT_POSITIONS
from parking_exp.envs.scenes import Scenes

COLUMNS = ("position", "direction")


@dataclass
class SceneState:
    """Everything that the future of n scenes depends on, besides the actions. Scenes are rows, or columns of `COLUMNS`.

    Attributes:
        goal: goal slots, shape (n,).
        position: of the cars, shape (2, n) [m].
        heading: shape (n,) [rad].
        direction: its cosine and sine, shape (2, n).
        speed: signed, shape (n,) [m/s].
        crashed: shape (n,).
        steps: policy steps since the start, shape (n,).
        parked: positions of the parked cars, shape (n, vehicles_count, 2) [m].
        parked_heading: shape (n, vehicles_count) [rad].
        hit: whether `impact` is to be applied in the next frame, shape (n, 1 + vehicles_count); first the car itself.
        impact: what a predicted collision will displace each by, shape (n, 1 + vehicles_count, 2) [m].
        disturbed: whether a parked car has been hit, shape (n,).
    """

    goal: np.ndarray
    position: np.ndarray
    heading: np.ndarray
    direction: np.ndarray
    speed: np.ndarray
    crashed: np.ndarray
    steps: np.ndarray
    parked: np.ndarray
    parked_heading: np.ndarray
    hit: np.ndarray
    impact: np.ndarray
    disturbed: np.ndarray

    @classmethod
    def at_start(cls, scenes: Scenes) -> Self:
        """Return the state in which scenes start."""
        n, count = scenes.parked.shape
        return cls(
            goal=scenes.goal.copy(),
            position=np.zeros((2, n)),
            heading=scenes.heading.copy(),
            direction=np.array([np.cos(scenes.heading), np.sin(scenes.heading)]),
            speed=np.zeros(n),
            crashed=np.zeros(n, bool),
            steps=np.zeros(n, np.int64),
            parked=SLOT_POSITIONS[scenes.parked],
            parked_heading=SLOT_HEADINGS[scenes.parked],
            hit=np.zeros((n, 1 + count), bool),
            impact=np.zeros((n, 1 + count, 2)),
            disturbed=np.zeros(n, bool),
        )

    def take(self, rows: np.ndarray) -> Self:
        """Return the state of some scenes, by index, as a copy."""
        return type(self)(**{name: array.take(rows, axis=int(name in COLUMNS)) for name, array in vars(self).items()})

    def put(self, rows: np.ndarray, other: Self) -> None:
        """Replace the state of some scenes."""
        for name, array in vars(self).items():
            array[(slice(None), rows) if name in COLUMNS else rows] = getattr(other, name)

"""State of many scenes as arrays."""

from dataclasses import dataclass, fields
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
        state = cls(
            goal=np.empty(n, np.int64),
            position=np.empty((2, n)),
            heading=np.empty(n),
            direction=np.empty((2, n)),
            speed=np.empty(n),
            crashed=np.empty(n, bool),
            steps=np.empty(n, np.int64),
            parked=np.empty((n, count, 2)),
            parked_heading=np.empty((n, count)),
            hit=np.empty((n, 1 + count), bool),
            impact=np.zeros((n, 1 + count, 2)),
            disturbed=np.empty(n, bool),
        )
        state.restart(slice(None), scenes)
        return state

    def restart(self, rows: np.ndarray | slice, scenes: Scenes) -> None:
        """Start new scenes in some rows."""
        self.goal[rows], self.heading[rows] = scenes.goal, scenes.heading
        self.direction[0, rows], self.direction[1, rows] = np.cos(scenes.heading), np.sin(scenes.heading)
        self.position[:, rows] = 0.0
        self.speed[rows] = 0.0
        self.steps[rows] = 0
        self.crashed[rows] = False
        self.hit[rows] = False
        self.disturbed[rows] = False
        if self.parked.shape[1]:
            self.parked[rows], self.parked_heading[rows] = SLOT_POSITIONS[scenes.parked], SLOT_HEADINGS[scenes.parked]

    def take(self, rows: np.ndarray) -> Self:
        """Return the state of some scenes, by index, as a copy."""
        return type(self)(**{name: a.take(rows, axis=int(name in COLUMNS)) for name, a in self.arrays()})

    def put(self, rows: np.ndarray, other: Self) -> None:
        """Replace the state of some scenes."""
        for name, array in self.arrays():
            array[(slice(None), rows) if name in COLUMNS else rows] = getattr(other, name)

    def arrays(self) -> list[tuple[str, np.ndarray]]:
        """Return all arrays by name."""
        return [(field.name, getattr(self, field.name)) for field in fields(self)]
